"""Logs of simulated tests: what a laboratory's recorder would have written of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agents.laboratory.logs.test_log import CURRENT, TARGET, TestLog, text_of_scenario
from shake_env.model.parameters import FloatArray
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.engine import BoolArray, StepResult


class LogRecorder:
    """Collects the logs of a roll-out; handed to `rollout` as its `log`.

    The measured channels are the readings of the scenario's sensors, noise included. Where the full
    state is shown they are the state of the actuator, the table acceleration and the base shear. The
    scenario of a log is the one that the controllers know: nothing of a drawn plant is in it.

    Parameters
    ----------
    scenario
        What is driven.
    earthquakes
        One a lane, as `rollout` takes them.
    lanes
        Indices of those to log; None: all.
    plant
        What is simulated in its place, with the same sensors: a hidden plant; None: the
        scenario itself.
    """

    def __init__(
        self,
        scenario: Scenario,
        earthquakes: Sequence[Earthquake],
        lanes: Sequence[int] | None = None,
        plant: Scenario | None = None,
    ) -> None:
        self.scenario, self.earthquakes = scenario, list(earthquakes)
        self.lanes = list(range(len(self.earthquakes)) if lanes is None else lanes)
        layout = scenario.observation
        self._full = scenario.sensing.full_state
        self._names = ("table_acceleration", "base_shear", *STATE_SIGNALS)
        if not self._full:
            self._names = layout.reading_names
        shown = (scenario if plant is None else plant).observation
        self._readings, self._scale = layout.readings, shown.reading_scale
        self._rows: list[FloatArray] = []
        self._periods = np.zeros(len(self.lanes), dtype=int)

    def add(self, result: StepResult, running: BoolArray) -> None:
        """Add a control period of the lanes that are `running` (N,)."""
        response = result.outcome.response
        if self._full:
            ends = (response.table_acceleration[:, -1], response.base_shear[:, -1])
            measured = [*ends, *(response.state[:, place] for place in STATE_SIGNALS.values())]
            readings = np.stack(measured, axis=-1)
        else:
            readings = result.observation[:, self._readings].astype(np.float64) * self._scale
        commanded = np.stack([result.ground.target[:, -1], result.outcome.current], axis=-1)
        self._rows.append(np.concatenate([commanded, readings], axis=-1)[self.lanes])
        self._periods += running[self.lanes]

    def logs(self, name: str = "") -> list[TestLog]:
        """Return the log of each lane; `name` goes ahead of the earthquake's."""
        rows = np.stack(self._rows, axis=1)
        made = []
        for lane, periods, row in zip(self.lanes, self._periods, rows, strict=True):
            quake = self.earthquakes[lane]
            driven = replace(self.scenario, motion=quake.motion)
            columns = dict(zip((TARGET, CURRENT, *self._names), row[:periods].T, strict=True))
            made.append(
                TestLog(
                    name=f"{name} {quake.name}".strip(),
                    sampling_interval=driven.control_period,
                    channels={key: np.ascontiguousarray(column) for key, column in columns.items()},
                    scenario_text=text_of_scenario(driven),
                    digest=scenario_digest(driven),
                    source="simulation",
                    input_unit=driven.input_unit,
                )
            )
        return made
