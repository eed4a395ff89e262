"""When the coupled actuator, structure and controller must be modelled in the analysis of a test's data.

An analysis that takes the table for rigid takes the target for the motion of the base. The error of the
specimen's response that the table made, ``e = f_s - f~_s``, it then attributes to the specimen: as far
as other masses, stiffnesses and dampings would make the same error. That part is the projection of e on
the sensitivities of the reference's base shear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import cont2discrete, dlsim

from agents.laboratory.forecasting.quantities import Outcomes
from shake_env.model.parameters import FloatArray, Specimen
from shake_env.model.plant import specimen_plant
from shake_env.motion.targets import RecordedMotion, target_history
from shake_env.scenario.plants.values import specimen_values, with_specimen_values
from shake_env.scenario.scenario import Scenario

TOLERANCE = 0.05  # of the specimen's response: more, put down to the specimen, is too much
STEP = 1e-3  # of a parameter, relative


@dataclass(frozen=True)
class Coupling:
    """What a rigid-table analysis would attribute to the specimen."""

    share: float  # of the squared error of the response, median [-]
    error: float  # rms of that part over the response's, 95 % of the samples are below it [-]
    stiffness: float  # apparent relative change of the first storey's stiffness, median [-]
    must_model: bool  # whether `error` is above `TOLERANCE`

    def __str__(self) -> str:
        verdict = "must be modelled" if self.must_model else "need not be modelled"
        return (
            f"the coupled system {verdict} in the analysis: a rigid table would put "
            f"{100 * self.share:.0f} % of the response's squared error down to the specimen, up to "
            f"{100 * self.error:.1f} % of the response (first storey: {100 * self.stiffness:+.1f} % of "
            "its stiffness)"
        )


def coupling(scenario: Scenario, amplitude: float, outcomes: Outcomes) -> Coupling:
    """Return what a rigid-table analysis of N tests would attribute to the specimen.

    Sensitivities are those of the linear specimen at the scenario's nominal values. Of filtered noise,
    whose samples have motions of their own, those to the nominal reference are taken from a delay-free
    fit of its own base shear, and only the stiffness's scale is meant.
    """
    motion = scenario.motion
    error = outcomes.base_shear - outcomes.reference
    power = np.sum(outcomes.reference**2, axis=1)
    if isinstance(motion, RecordedMotion):
        columns = amplitude * _sensitivities(scenario, motion, outcomes.time)
        names = [*specimen_values(scenario.specimen)]
    else:
        columns, names = None, ["storey_stiffness_1"]
    shares, errors, changes = [], [], []
    for n, row in enumerate(error):
        basis = outcomes.reference[n][:, None] if columns is None else columns
        size = np.linalg.norm(basis, axis=0)
        scaled = basis / np.where(size > 0.0, size, 1.0)
        weights, *_ = np.linalg.lstsq(scaled, row, rcond=1e-6)
        part = scaled @ weights
        total = float(row @ row)
        shares.append(float(part @ part) / total if total > 0.0 else 0.0)
        errors.append(float(np.sqrt(part @ part / power[n])) if power[n] > 0.0 else 0.0)
        place = names.index("storey_stiffness_1")
        changes.append(float(weights[place] / size[place]) if size[place] > 0.0 else 0.0)
    high = float(np.quantile(errors, 0.95))
    return Coupling(float(np.median(shares)), high, float(np.median(changes)), high > TOLERANCE)


def _sensitivities(scenario: Scenario, motion: RecordedMotion, time: FloatArray) -> FloatArray:
    """Return the derivative of the base shear (points, parameters) by each parameter's logarithm."""
    target, step = target_history(motion, scenario.physics_step).acceleration, scenario.physics_step
    places = np.minimum(np.round(time / step).astype(int), len(target) - 1)
    specimen = scenario.specimen
    columns = []
    for name, value in specimen_values(specimen).items():
        if not value:
            columns.append(np.zeros(len(time)))
            continue
        up, down = (
            _base_shear(with_specimen_values(specimen, {name: value * (1.0 + s)}), target, step)
            for s in (STEP, -STEP)
        )
        columns.append(((up - down) / (2.0 * STEP))[places])
    return np.stack(columns, axis=-1)


def _base_shear(specimen: Specimen, target: FloatArray, step: float) -> FloatArray:
    """Return the base shear (samples,) of a linear specimen on a base that moves as its target."""
    plant = specimen_plant(specimen)
    discrete = cont2discrete((plant.A, plant.B, plant.C, plant.D), step, method="foh")
    shear: FloatArray = dlsim((*discrete[:4], step), target)[1][:, 0]
    return shear
