"""Sensors, observation and the law on an estimate as one matrix over the signals of a control period."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from agents.policies.estimated_law import EstimatedLaw
from shake_env.dynamics.ground import GroundPeriod
from shake_env.dynamics.linear import PeriodResponse
from shake_env.model.parameters import FloatArray
from shake_env.scenario.observation import FLOOR_ACCELERATIONS
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import TableModel


@dataclass(frozen=True)
class Signals:
    """From a period's end to what is shown and remembered, as one matrix.

    Columns: ``[state, y_A, f_s, floors, bias + noise + rounding, history, action, memory]`` and then the
    exogenous ``[filter state, reference, preview]``. Rows: ``[readings without what is added, history,
    observation, estimate and rest of the law's memory, belief, innovation]``; the innovation's share of
    estimate and belief comes with the estimator's gain, which depends on the age of an episode.
    """

    matrix: FloatArray  # (rows, columns)
    gained: FloatArray  # (rows, estimates) from a change of the estimate to all rows
    columns: dict[str, slice]
    rows: dict[str, slice]

    @classmethod
    def from_model(cls, model: TableModel, law: EstimatedLaw | None) -> Signals:
        """Run sensors and estimator on a basis.

        Parameters
        ----------
        model
            In numpy; its sensors are common to the tables.
        law
            The law behind an estimator, or None.
        """
        measurement, layout = model.measurement, model.measurement.layout
        s, stories = layout.readings_count, layout.plant.specimen.stories
        rest = measurement.rest(1)
        widths = {
            "state": max(model.controlled, 1 + int(np.max(measurement.places, initial=0))),
            "acceleration": 1, "shear": 1, "floors": stories * measures_floors(model), "added": s,
            "past": rest.past[0].size, "action": 1, "law": law.size if law else 0,
            "ground": model.filter_states, "reference": 2 * stories, "preview": layout.preview_samples,
        }  # fmt: skip
        columns = _places(widths)
        basis = np.eye(sum(widths.values()))
        part = {name: basis[:, place] for name, place in columns.items()}
        batch = len(basis)
        exact = replace(model, measurement=replace(measurement, rounded=np.zeros(s)))
        response = PeriodResponse(part["state"], part["acceleration"], part["shear"])
        target = np.zeros((batch, 1))  # not read by sensors
        ground = GroundPeriod(
            part["ground"], part["reference"], target, target, None,
            part["preview"] if layout.preview_samples else None,
        )  # fmt: skip
        past, none = part["past"].reshape(batch, *rest.past.shape[1:]), np.zeros((batch, s))
        memory = SensorMemory(none, none, np.zeros(batch), past)
        floors = part["floors"] if widths["floors"] else None
        observation, memory = exact.look(
            response, floors, ground, part["action"][:, 0], memory, part["added"]
        )
        signals = np.zeros((batch, 0))
        if s:
            last = (part["state"], part["acceleration"][:, 0], part["shear"][:, 0])
            signals = measurement.signals(*last, floors)
        made = {
            "signals": signals,
            "past": memory.past.reshape(batch, -1),
            "observation": observation,
        }
        estimates = 0
        if law is not None:
            both = np.concatenate([part["law"], observation], axis=-1) @ law.advance.T
            known = both[:, : law.size]
            belief = np.concatenate([known, observation], axis=-1) @ law.show.T
            made |= {"law": known, "belief": belief, "innovation": both[:, law.size :]}
            estimates = law.gains.shape[1]
        rows = _places({name: values.shape[-1] for name, values in made.items()})
        gained = np.zeros((sum(values.shape[-1] for values in made.values()), estimates))
        if law is not None:
            gained[rows["law"]][:estimates] = np.eye(estimates)
            gained[rows["belief"]] = law.show[:, :estimates]
        return cls(np.concatenate(list(made.values()), axis=-1).T, gained, columns, rows)


def measures_floors(model: TableModel) -> bool:
    """Return whether a sensor measures the accelerations of the floors."""
    sensors = model.measurement.layout.sensing.sensors or ()
    return any(sensor.signal == FLOOR_ACCELERATIONS for sensor in sensors)


def _places(widths: dict[str, int]) -> dict[str, slice]:
    ends = np.cumsum(list(widths.values()))
    return {
        name: slice(int(end - width), int(end))
        for (name, width), end in zip(widths.items(), ends, strict=True)
    }
