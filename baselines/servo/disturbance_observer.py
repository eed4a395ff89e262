"""A disturbance observer around any controller: the classical form of friction compensation.

Ohnishi, Shibata and Murakami (IEEE/ASME Trans. Mechatronics 1, 1996): what the table does that a simple
nominal model does not explain is called a disturbance at its input, low-passed, and taken off the next
command. The nominal model is first order with dead time, ``T_n v' + v = k_v u(t - tau)``: T_n is the
valve's lag, tau the loop's delay and half the hold. Its inverse needs velocity and acceleration, both
measured, and no derivative. Friction, orifice flow and leakage all come out as such a current.

What it cannot do follows from its rule: where the oil column rings, the simple model is wrong by a
multiple of itself, and the corner has to stay far below. Friction's kick at a reversal lies above it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from baselines.servo.output_feedback import NominalTable
from baselines.servo.signals import ACCELERATION, VELOCITY, Memory, SignalReader, recall
from shake_env.controller import Controller, decide
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray, is_number, require_positive
from shake_env.scenario.scenario import Scenario

NEEDS = ("table_velocity", "table_acceleration")
CORNERS = np.geomspace(0.05, 40.0, 200)  # [Hz] among which the rule looks


@dataclass(frozen=True, kw_only=True)
class ObserverDesign:
    """The observer's low-pass Q, of second order and critically damped.

    Without `corner` it is the highest at which ``|Q (1 - G / G_n)| <= margin`` at every frequency, with
    G the nominal table and G_n the simple model: the small-gain theorem then keeps the observer's own
    loop stable, whatever the phase.
    """

    corner: float | None = None  # [Hz]
    margin: float = 0.7  # [-]

    def __post_init__(self) -> None:
        if self.corner is not None:
            require_positive(self, "corner")
        if not (is_number(self.margin) and 0.0 < self.margin < 1.0):
            raise ParameterError("margin", self.margin, "must lie between 0 and 1")


def dead_periods(scenario: Scenario) -> float:
    """Return the dead time of the simple model in control periods: delay, and half the hold."""
    return scenario.delay / scenario.substeps + 0.5


def model_mismatch(scenario: Scenario, frequency: FloatArray) -> FloatArray:
    """Return ``|1 - G / G_n|`` of the disturbance observer's model at `frequency` (f,) [Hz]."""
    table, s = NominalTable.from_scenario(scenario), 2j * math.pi * frequency
    lag = scenario.actuator.valve_time_constant
    # The samples of the response are those at the period's ends; the command's are at their starts.
    simple = scenario.actuator.velocity_gain / (1.0 + lag * s)
    simple = simple * np.exp(-s * dead_periods(scenario) * table.period)
    missed: FloatArray = np.abs(1.0 - table.response(frequency)[:, VELOCITY] / simple)
    return missed


def observer_corner(scenario: Scenario, design: ObserverDesign) -> float:
    """Return the corner of Q [Hz] that a design gives on a scenario's nominal table."""
    if design.corner is not None:
        return design.corner
    frequency = np.geomspace(0.05, 0.5 * scenario.control_rate, 4000)
    missed = model_mismatch(scenario, frequency)
    worst = np.array([np.max(missed / (1.0 + (frequency / c) ** 2)) for c in CORNERS])
    allowed = CORNERS[worst <= design.margin]
    return float(allowed[-1]) if len(allowed) else float(CORNERS[0])


class DisturbanceObserver:
    """A controller with what makes up for the disturbance added to its current; itself a `Controller`.

    Parameters
    ----------
    scenario
        Whose observation it reads.
    controller
        What is wrapped.
    design
        The observer's; None: the default rule.
    """

    def __init__(
        self, scenario: Scenario, controller: Controller, design: ObserverDesign | None = None
    ) -> None:
        self.controller = controller
        self.reader, self._shown = SignalReader(scenario, NEEDS), scenario.observation
        self.limit = scenario.current_limit  # [A]
        self.velocity_gain = scenario.actuator.velocity_gain  # [m/s per A]
        self.lag = scenario.actuator.valve_time_constant  # [s]
        corner = observer_corner(scenario, design or ObserverDesign())
        # Share of what is unexplained that Q takes up in a period [-].
        self.follow = -math.expm1(-2.0 * math.pi * corner * scenario.control_period)
        # Commands before the present, newest first, as they arrive at the middle of the dead time.
        dead = dead_periods(scenario)
        whole = math.floor(dead)
        self.arrivals = np.zeros(whole + 2)
        self.arrivals[whole] = 1.0 - (dead - whole)
        self.arrivals[whole + 1] = dead - whole
        # The response at this sample is of commands up to the last period.
        self.arrivals = self.arrivals[1:] + np.eye(whole + 1)[0] * self.arrivals[0]

    def compensation(self, state: Memory) -> FloatArray:
        """Return the current (...) [A] that makes up for the disturbance: its negative."""
        estimate: FloatArray = state[0][..., self.reader.memory_size + 1]
        return estimate

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Memory | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], Memory | None]:
        """Return the action (..., 1) for an observation (..., n), and the memory."""
        own, lead = self.reader.memory_size, observation.shape[:-1]
        mine = None if state is None else state[:1]
        inner = None if state is None else state[1]
        memory = recall(mine, episode_start, lead, own + 2 + len(self.arrivals))
        signals, read = self.reader.read(observation, memory[..., :own])
        first, second, past = memory[..., own], memory[..., own + 1], memory[..., own + 2 :]
        if self._shown.sensing.last_action:  # what was given, which a supervisor may have changed
            given = self.limit * observation[..., self._shown.last_action]
            past = np.concatenate([given, past[..., 1:]], axis=-1)
        needed = (signals[..., VELOCITY] + self.lag * signals[..., ACCELERATION]) / self.velocity_gain
        unexplained = past @ self.arrivals - needed
        first = first + self.follow * (unexplained - first)
        second = second + self.follow * (first - second)
        asked, inner = decide(self.controller, observation, inner, episode_start, deterministic)
        action = np.clip(asked[..., 0] + second / self.limit, -1.0, 1.0)
        past = np.concatenate([self.limit * action[..., None], past[..., :-1]], axis=-1)
        next_memory = np.concatenate([read, first[..., None], second[..., None], past], axis=-1)
        return action[..., None].astype(np.float32), (np.nan_to_num(next_memory), inner)
