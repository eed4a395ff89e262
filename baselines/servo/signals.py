"""What a laboratory's controller reads: the table's signals and the target's, whatever the sensing.

Classical controllers work on eight signals, in this order: table displacement, velocity, acceleration,
load pressure and spool position, then the target's acceleration, velocity and displacement. All but the
last are rows of one matrix on the observation; without a high-pass the ground's displacement is no state
and is integrated in the controller's memory.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import ground_filter
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario

TABLE_SIGNALS = (
    "table_displacement", "table_velocity", "table_acceleration", "load_pressure", "spool_position",
)  # fmt: skip
DISPLACEMENT, VELOCITY, ACCELERATION, PRESSURE, SPOOL = range(5)  # places among the signals
TARGET_ACCELERATION, TARGET_VELOCITY, TARGET_DISPLACEMENT = range(5, 8)
SIGNALS = 8

Memory = tuple[Any, ...]  # what a controller returns and gets back; here always one array (..., m)


def recall(
    state: Memory | None, episode_start: NDArray[np.bool_] | None, lead: tuple[int, ...], size: int
) -> FloatArray:
    """Return a controller's memory (*lead, size), zero where an episode has just begun.

    Parameters
    ----------
    state
        What the last call returned; None at the start.
    episode_start
        (N,), or (1,) for a single table; None: nowhere.
    lead
        Leading axes of the observation.
    size
        Entries of a table's memory.
    """
    if state is None:
        return np.zeros((*lead, size))
    memory: FloatArray = state[0]
    if episode_start is None:
        return memory
    begun = np.asarray(episode_start, dtype=bool).reshape(lead)
    fresh: FloatArray = np.where(begun[..., None], 0.0, memory)
    return fresh


def as_action(current: FloatArray, current_limit: float) -> NDArray[np.float32]:
    """Return currents (...) [A] as the action (..., 1) that the environment takes, within [-1, 1].

    A current that is no number becomes none: a law that gives no finite current closes the valve.
    """
    action = np.clip(np.nan_to_num(current / current_limit), -1.0, 1.0)
    return action[..., None].astype(np.float32)


class SignalReader:
    """Takes the eight signals (..., 8) in SI from an observation (..., n).

    With the full state the acceleration is the linear plant's: what friction and yielding add to it is
    not in that observation.

    Parameters
    ----------
    scenario
        Whose observation is read.
    needs
        Names among `TABLE_SIGNALS` that the controller cannot do without; others that are not measured
        read zero.

    Raises
    ------
    ScenarioError
        If a signal is needed and not measured.
    """

    memory_size = 2  # integral of the target velocity [m], and its last value [m/s]

    def __init__(self, scenario: Scenario, needs: Sequence[str] = TABLE_SIGNALS) -> None:
        layout, plant = scenario.observation, scenario.plant
        rows = np.zeros((SIGNALS, layout.size))
        if scenario.sensing.full_state:
            states = plant.layout
            for place, name in enumerate(TABLE_SIGNALS):
                if name in STATE_SIGNALS:
                    at = states.actuator.start + STATE_SIGNALS[name]
                    rows[place, at] = plant.state_scale[at]
            rows[ACCELERATION, : states.order] = plant.coupled.C[0] * plant.state_scale
        else:
            missing = [name for name in needs if name not in layout.reading_names]
            if missing:
                raise ScenarioError(
                    "sensing", layout.reading_names, f"add sensors of {', '.join(missing)}"
                )
            for column, name in enumerate(layout.reading_names):
                if name in TABLE_SIGNALS:
                    at = layout.readings.start + column
                    rows[TABLE_SIGNALS.index(name), at] = layout.reading_scale[column]
        w = plant.layout.filter_states
        scale = plant.state_scale[:w]
        rows[TARGET_ACCELERATION, :w] = ground_filter(plant.ground).C[0] * scale
        self.integrates = w == 2
        if self.integrates:
            rows[TARGET_VELOCITY, 0] = 2.0 * plant.ground.damping_ratio * plant.ground.omega * scale[0]
        else:
            rows[TARGET_DISPLACEMENT, 2], rows[TARGET_VELOCITY, 3] = scale[2], scale[3]
        self.rows = rows.T.copy()  # (size, 8) signals in SI per entry of the observation
        self.half_period = 0.5 * scenario.control_period  # [s]

    def read(
        self, observation: NDArray[np.float32], memory: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the signals (..., 8) and the reader's memory (..., 2), zero at an episode's start."""
        signals: FloatArray = observation.astype(np.float64) @ self.rows
        if not self.integrates:
            return signals, memory
        velocity = signals[..., TARGET_VELOCITY]
        displacement = memory[..., 0] + self.half_period * (memory[..., 1] + velocity)
        signals[..., TARGET_DISPLACEMENT] = displacement
        return signals, np.stack([displacement, velocity], axis=-1)
