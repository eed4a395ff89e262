"""What a table does without a command: hold the last one, then brake; likewise where a sensor sticks."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.safety.braking import braking_law
from shake_env.safety.sensor_faults import Channels
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario

Mode = Literal["command", "hold", "brake"]


@dataclass
class HoldThenBrake:
    """The last stage before the valve.

    A valid command passes. Without one the last is held for `hold` periods, and then the braking law of
    the supervisor (`shake_env.safety.braking`) lets the valve close and brings the table to its middle.
    A reading that is no number, out of range or equal for longer than its noise allows
    (`shake_env.safety.sensor_faults`) brakes at once, whatever is commanded.
    """

    scenario: Scenario
    hold: int = 2  # control periods
    missing: int = 0  # periods in a row without a command
    last: float = 0.0  # [A] sent
    faulty: tuple[str, ...] = ()  # sensors found faulty in this period
    _before: FloatArray = field(init=False)
    _equal: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self._law = braking_law(self.scenario)
        shown = self.scenario.observation
        known = shown.sensing.full_state or all(name in shown.reading_names for name in STATE_SIGNALS)
        self._channels = Channels.from_scenario(self.scenario) if known else None
        if self._channels is None and "table_displacement" not in shown.reading_names:
            raise ScenarioError(
                "sensing", shown.reading_names, "braking needs the table's displacement: add its sensor"
            )
        count = 0 if self._channels is None else len(self._channels.names)
        self._before, self._equal = np.full((1, count), np.nan), np.zeros((1, count), dtype=np.int64)

    def decide(self, observation: FloatArray, command: float | None) -> tuple[float, Mode]:
        """Return the current [A] to send and why.

        Parameters
        ----------
        observation
            (n,) of this period, over its scales.
        command
            [A] of the controller for this period; None: none came in time.
        """
        displacement = self._look(observation)
        limit = self.scenario.current_limit
        self.missing = 0 if command is not None else self.missing + 1
        mode: Mode
        if self.faulty or self.missing > self.hold:
            braked = self._law[TABLE_DISPLACEMENT] * displacement + self._law[-1] * self.last
            current, mode = -braked, "brake"
        elif command is None:
            current, mode = self.last, "hold"
        else:
            current, mode = command, "command"
        self.last = float(np.clip(current, -limit, limit))
        return self.last, mode

    def _look(self, observation: FloatArray) -> float:
        """Judge the readings; return the displacement [m], 0 where its sensor is faulty."""
        channels = self._channels
        if channels is None:
            layout = self.scenario.observation
            place = layout.reading_names.index("table_displacement")
            return float(observation[layout.readings.start + place] * layout.reading_scale[place])
        readings = (observation[channels.places] * channels.scale)[None]
        impossible, _, self._equal = channels.incredible(readings, self._before, self._equal)
        self._before = readings
        self.faulty = tuple(np.asarray(channels.names)[impossible[0]].tolist())
        place = channels.names.index("table_displacement")
        return 0.0 if impossible[0, place] else float(readings[0, place])
