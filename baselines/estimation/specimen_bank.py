"""Specimens that may stand on the table, and the preview LQR of each, for laws that find out which.

Candidates lie on a grid of storey frequency and mass ratio. For a given motion of its base a specimen's
displacements depend on the frequency alone, and its base shear is proportional to its mass: one filter
a frequency serves all masses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from baselines.lqr.preview import preview_lqr
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.discretization import first_order_hold, noise_covariance, zero_order_hold
from shake_env.model.parameters import FloatArray, Specimen
from shake_env.model.plant import StateSpace, ground_filter, specimen_plant
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform


@dataclass(frozen=True)
class SpecimenBank:
    """F storey frequencies by M mass ratios, their filters and laws.

    A law is one row [A per SI unit] over ``[x_W, x_A, x_S, x~_S, previewed y~, last command]``: LQR of
    the state at which the command will arrive, and the prediction of that state, in one.
    """

    frequencies: FloatArray  # (F,) [Hz]
    mass_ratios: FloatArray  # (M,) [-]
    laws: FloatArray  # (F, M, n + p + 1)
    advance: FloatArray  # (F, 2 stories, 2 stories) specimen's state over a control period
    now: FloatArray  # (F, 2 stories) what the base's acceleration at its start adds
    following: FloatArray  # (F, 2 stories) and at its end; straight between
    shear: FloatArray  # (F, 2 stories) base shear of a specimen of mass ratio 1 [N]

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, frequencies: int = 17, masses: int = 5, position: float | None = None
    ) -> SpecimenBank:
        """Lay the grid over the scenario's uncertainty, and design.

        Parameters
        ----------
        scenario
            Its nominal model; what its uncertainty leaves alone, every candidate has of it.
        frequencies, masses
            Points of the grid, where the scenario is uncertain.
        position
            [m] see `preview_lqr`.

        Raises
        ------
        ParameterError
            If a grid has less than 2 points.
        ScenarioError
            If the loop delay is longer than a control period, or than a preview's spacing.
        """
        if min(frequencies, masses) < 2:
            raise ParameterError("grid", (frequencies, masses), "needs at least 2 points a side")
        uncertain, table_mass = scenario.uncertainty, scenario.actuator.table_mass
        values = scenario.specimen.uniform_values(table_mass)
        f = _points(uncertain.storey_frequency, values["storey_frequency"], frequencies)
        mu = _points(uncertain.mass_ratio, values["mass_ratio"], masses)
        known = replace(scenario, uncertainty=Uncertainty())

        def candidate(frequency: float, mass_ratio: float) -> Specimen:
            own = {**values, "storey_frequency": frequency, "mass_ratio": mass_ratio}
            return Specimen.uniform(**own, table_mass=table_mass)

        laws = [
            [arriving_law(replace(known, specimen=candidate(a, b)), position) for b in mu] for a in f
        ]
        unit = [candidate(a, 1.0) for a in f]
        filters = [specimen_filter(one, scenario.control_period) for one in unit]
        advance, now, following = (np.stack([each[i] for each in filters]) for i in range(3))
        shear = np.stack([specimen_plant(one).C[0] for one in unit])
        return cls(f, mu, np.array(laws), advance, now, following, shear)

    def law(self, mass_ratio: FloatArray) -> FloatArray:
        """Return each frequency's law at its own mass ratio (..., F), straight between the grid's."""
        if len(self.mass_ratios) == 1:
            return np.broadcast_to(self.laws[:, 0], (*mass_ratio.shape, self.laws.shape[-1]))
        low, high = self.mass_ratios[[0, -1]]
        place = (np.clip(mass_ratio, low, high) - low) / (high - low) * (len(self.mass_ratios) - 1)
        at = np.minimum(place.astype(int), len(self.mass_ratios) - 2)
        share = (place - at)[..., None]
        row = np.arange(len(self.frequencies))
        law: FloatArray = (1.0 - share) * self.laws[row, at] + share * self.laws[row, at + 1]
        return law


def _points(uncertain: Uniform | None, nominal: float, number: int) -> FloatArray:
    if uncertain is None or uncertain.low == uncertain.high:
        return np.array([nominal if uncertain is None else uncertain.low])
    return np.linspace(uncertain.low, uncertain.high, number)


def specimen_filter(specimen: Specimen, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the specimen's update under a base acceleration that runs straight between samples."""
    model = specimen_plant(specimen)
    held, following = first_order_hold(model, period, np.ones(model.order))
    return held.A, held.B[:, 0], following[:, 0]


def arriving_law(scenario: Scenario, position: float | None) -> FloatArray:
    """Return the preview LQR of a scenario with a loop delay, (n + p + 1), see `SpecimenBank`.

    A command given now acts from the delay d on. The law is that of the plant without delay, at the
    state in which it will be then: table and specimen under the last command; the ground filter by its
    expectation given its state and the previewed samples up to the first behind d; the target straight
    between samples. Of the preview, the samples that reach beyond d are used.
    """
    layout, discrete, shown = scenario.plant.layout, scenario.discrete, scenario.observation
    n, samples = layout.order, shown.preview_samples
    spacing = shown.preview_spacing * scenario.physics_step if samples else scenario.control_period
    d = scenario.delay * scenario.physics_step
    whole, share = divmod(round(d / spacing, 9), 1.0)
    passed = int(whole)  # samples up to the delay's end
    gone = passed + (share > 0.0)
    if d > scenario.control_period * (1.0 + 1e-9):
        raise ScenarioError("delay", scenario.delay, f"must be at most {scenario.substeps} steps")
    if samples and gone > samples:
        raise ScenarioError("preview", scenario.sensing.preview, "must reach over the loop delay")
    previewed = max(samples - gone, 0)
    design = preview_lqr(
        discrete, scenario.stage_cost, previewed * spacing, spacing if samples else None, position
    )
    row = np.concatenate([-design.gain, design.preview_gain])
    if d == 0.0:
        return np.append(row, 0.0)
    predict = np.zeros((n + previewed, n + samples + 1))
    inside, scale = layout.controlled, scenario.plant.state_scale
    coupled = scenario.plant.coupled
    table = StateSpace(
        coupled.A[inside, inside], coupled.B[inside, :1], coupled.C[:1, inside], coupled.D[:1, :1]
    )
    moved = zero_order_hold(table, d, scale[inside])
    predict[inside, inside], predict[inside, -1] = moved.A, moved.B[:, 0]
    # The target now and at the coming samples, as rows over what is shown.
    w, reference = layout.ground, layout.reference
    source = ground_filter(scenario.ground)
    target = np.zeros((1 + max(samples, gone), n + samples + 1))
    target[0, w] = source.C[0]
    if samples:
        target[1:, n:-1] = np.eye(samples)
    else:
        target[1, w] = source.C[0] @ expm(source.A * spacing)
    predict[w] = _expected_filter(source, scale[w], d, spacing, target, gone if samples else 0, w)
    at_end = (1.0 - share) * target[passed] + share * target[gone]
    predict[reference, reference] = np.eye(2 * layout.stories)
    pieces = [(spacing, target[j], target[j + 1]) for j in range(passed)]
    if share:
        pieces.append((share * spacing, target[passed], at_end))
    for length, first, last in pieces:
        hold, start, end = specimen_filter(scenario.specimen, length)
        predict[reference] = hold @ predict[reference] + np.outer(start, first) + np.outer(end, last)
    for j in range(previewed):
        predict[n + j] = (1.0 - share) * target[passed + j + 1] + share * target[gone + j + 1]
    arriving: FloatArray = row @ predict
    return arriving


def _expected_filter(
    source: StateSpace,
    scale: FloatArray,
    d: float,
    spacing: float,
    target: FloatArray,
    samples: int,
    ground: slice,
) -> FloatArray:
    """Return the ground filter's expected state after d seconds, (w, columns of `target`).

    Parameters
    ----------
    source, scale
        The filter and the sizes (w,) of its state.
    target
        (1 + samples or more, columns) target at multiples of `spacing`, as rows over what is shown.
    samples
        Of the coming target that the expectation is given.
    ground
        Where the filter's state lies in the columns.
    """
    w = len(scale)

    def covariance(early: float, late: float) -> FloatArray:
        """Return the noise's covariance of the state at two times, (w, w), the late one first."""
        spread: FloatArray = expm(source.A * (late - early)) @ noise_covariance(
            source.A, source.B, early, scale
        )
        return spread

    expected = np.zeros((w, target.shape[1]))
    expected[:, ground] = expm(source.A * d)
    times, C = spacing * np.arange(1, samples + 1), source.C[0]
    given = np.array([[C @ covariance(min(s, t), max(s, t)) @ C for s in times] for t in times])
    cross = [covariance(d, t).T @ C if t > d else covariance(t, d) @ C for t in times]
    if samples:
        surprise = target[1 : samples + 1].copy()
        surprise[:, ground] -= [C @ expm(source.A * t) for t in times]
        expected += np.linalg.solve(given, np.array(cross)).T @ surprise
    return expected
