"""A supervisor: any controller's command, limited so that the table's hard limits are not reached.

A command governor with a way back (Gilbert and Kolmanovsky, Automatica 38, 2002; the way back as in the
predictive safety filter of Wabersich and Zeilinger, Automatica 129, 2021). A command passes if braking
from the next period on would keep every limit, under every specimen that the table may carry. One that
would not is moved to the nearest that would; where there is none, the table brakes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from shake_env.controller import Controller, decide
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray, Specimen
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_VELOCITY
from shake_env.safety.braking import ACTUATOR, BrakingPrediction
from shake_env.safety.interventions import Interventions
from shake_env.safety.table_state_observer import Estimate, ObserverMemory, TableStateObserver
from shake_env.scenario.observation import STATE_SIGNALS
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uniform

# Share of each hard limit that predicted braking may reach. What the prediction leaves out (the
# orifice above all) errs in acceleration by a tenth, in displacement hardly at all.
SHARES = {
    "table_displacement": 0.95,
    "table_velocity": 0.95,
    "load_pressure": 0.85,
    "table_acceleration": 0.80,
    "specimen_acceleration": 0.80,
}
MASS_RATIO, STOREY_FREQUENCY = Uniform(0.1, 1.0), Uniform(5.0, 9.0)  # [-], [Hz] of what may be carried
# A specimen driven at its resonance is at most half of this from the nearest that is looked at, which
# then answers with 0.93 of what it does, at 5 % of damping.
FREQUENCY_RATIO = 1.04
TRUST = 0.7  # [-] share of an unexpected velocity that is taken for a force
DEVIATIONS = 2.0  # [-] of an estimate's rms error that a margin holds
MISFIT = 3.0  # [-] share of the recent prediction errors that a margin holds
ROUNDING = 1e-6  # [-] of full current; a smaller change of a command is none


OTHER_ENTRIES = "other entries"  # of an observation, besides the readings of the table


@dataclass(frozen=True)
class Memory:
    """What the supervisor remembers of each table; leading axis N."""

    commands: FloatArray  # (N, c) sent and still under way, oldest first [A]
    velocity: FloatArray  # (N,) v_a as last read [m/s]
    expected: FloatArray  # (H, N) v_a that was expected for now [m/s]
    specimens: FloatArray  # (H, N, 2 stories) [x_r, w] of each specimen that may be there
    force: FloatArray  # (H, N) on the table, besides that specimen's [N]
    steps: NDArray[np.int64]  # (N,) commands so far
    acted: NDArray[np.int64]  # (N,) of them changed
    braked: NDArray[np.int64]  # (N,) of them replaced by braking
    not_finite: NDArray[np.int64]  # (N,) of them that were no finite number
    largest: FloatArray  # (N,) largest change of a finite command [-] of full current


@dataclass(frozen=True)
class HeldEntries:
    """The last finite value of each entry of an observation; leading axis N."""

    values: NDArray[np.float32]  # (N, n)
    faults: NDArray[np.int64]  # (N,) observations in which an entry besides x_A's was not finite


class Supervised:
    """A controller whose commands are limited.

    Parameters
    ----------
    controller
        What is supervised.
    scenario
        Whose limits are kept; its nominal table, delay and sensing are what the supervisor knows.
    mass_ratio, storey_frequency
        Ranges [-], [Hz] of the specimens that the table may carry; widened by the scenario's own
        uncertainty and nominal specimen. Storeys, and how mass and stiffness are spread over them, are
        the nominal specimen's.

    Raises
    ------
    ScenarioError
        If the scenario has no limit to keep, does not show what the supervisor needs (displacement,
        velocity, load pressure and spool position of the table), or has printed equations.
    """

    def __init__(
        self,
        controller: Controller,
        scenario: Scenario,
        *,
        mass_ratio: Uniform = MASS_RATIO,
        storey_frequency: Uniform = STOREY_FREQUENCY,
    ) -> None:
        self.controller, self.scenario = controller, scenario
        limits = scenario.limits
        bounds = {
            name: share * getattr(limits, name)
            for name, share in SHARES.items()
            if getattr(limits, name) is not None
        }
        if not bounds:
            raise ScenarioError("limits", limits, 'has none to keep: limits="laboratory" has')
        # A float32 of the largest command allowed must not round to a larger one.
        allowed = math.inf if limits.current is None else limits.current * (1.0 - 1e-6)
        self.most = min(1.0, allowed / scenario.current_limit)  # largest action that is sent [-]
        bounds["current"] = self.most * scenario.current_limit
        _require_readings(scenario)
        specimens = _family(scenario, mass_ratio, storey_frequency)
        self.observer = TableStateObserver.from_scenario(scenario)
        noise = self.observer.channels.noise[:ACTUATOR]
        self.prediction = BrakingPrediction.from_scenario(scenario, specimens, bounds, noise)
        # What an error of x_A does to every look ahead, (H, 4, R) [A per SI unit].
        self.sensitivity = np.abs(self.prediction.rows[:, :ACTUATOR])
        self._latest: tuple[Memory, ObserverMemory, HeldEntries] | None = None

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...]]:
        """Return the controller's action (..., 1), limited, and ``(its state, the supervisor's)``."""
        inner, memory, sensors, held = (None, None, None, None) if state is None else state
        channels = self.observer.channels
        # Read before the controller is asked: nothing that it does to an array counts.
        readings = np.atleast_2d(observation)[:, channels.places] * channels.scale
        begins = np.zeros(len(readings), dtype=bool)
        if episode_start is not None:
            begins |= np.atleast_1d(episode_start)
        if sensors is None:
            sensors = self.observer.begin(len(readings))
        estimate, sensors = self.observer.look(self.observer.afresh(sensors, begins), readings)
        # The controller is shown what is believed in place of a faulty reading, and the last finite
        # value of any other entry, so that nothing that is not a number stays in its memory.
        shown = np.array(observation)
        rows = shown.reshape(len(readings), -1)
        held = _hold_finite(held, rows, begins, channels.places)
        if estimate.faulty.any():
            believed = estimate.readings / channels.scale
            rows[:, channels.places] = np.where(estimate.faulty, believed, rows[:, channels.places])
        action, inner = decide(self.controller, shown, inner, episode_start, deterministic)
        wanted = np.array(action, dtype=np.float64).reshape(len(readings))
        memory = self._look(memory, estimate.table, begins)
        sent, memory, under_way = self._limit(memory, estimate, sensors.misfit, wanted)
        sensors = self.observer.predict(sensors, under_way, self._flow(estimate.table))
        self._latest = (memory, sensors, held)
        return sent.astype(np.float32).reshape(np.shape(action)), (inner, memory, sensors, held)

    def interventions(self, state: tuple[Any, ...] | None = None) -> Interventions:
        """Return how often the supervisor acted, up to `state` or else up to its last call."""
        latest = self._latest if state is None else (state[1], state[2], state[3])
        names = self.observer.channels.names
        if latest is None:
            none = np.zeros(0, dtype=np.int64)
            faults = dict.fromkeys((*names, OTHER_ENTRIES), none)
            return Interventions(none, none, none, none, np.zeros(0), faults)
        memory, sensors, held = latest
        faults = dict(zip(names, sensors.faults.T, strict=True)) | {OTHER_ENTRIES: held.faults}
        return Interventions(
            memory.steps, memory.acted, memory.braked, memory.not_finite, memory.largest, faults
        )

    def _look(self, memory: Memory | None, readings: FloatArray, begins: NDArray[np.bool_]) -> Memory:
        """Return the memory with what the readings (N, 4) say of the specimens and forces."""
        prediction = self.prediction
        velocity = readings[:, TABLE_VELOCITY]
        lanes, hypotheses, floors = len(readings), len(prediction.push), prediction.carry.shape[1]
        if memory is None:
            count = np.zeros(lanes, dtype=np.int64)
            memory = Memory(
                commands=np.zeros((lanes, len(prediction.feedback) - ACTUATOR)),
                velocity=velocity,
                expected=np.zeros((hypotheses, lanes)),
                specimens=np.zeros((hypotheses, lanes, floors)),
                force=np.zeros((hypotheses, lanes)),
                steps=count, acted=count, braked=count, not_finite=count, largest=np.zeros(lanes),
            )  # fmt: skip
            begins = np.ones(lanes, dtype=bool)
        before = np.broadcast_to(memory.velocity[:, None], (hypotheses, lanes, 1))
        after = np.broadcast_to(velocity[:, None], (hypotheses, lanes, 1))
        carried = np.concatenate([memory.specimens, before, after], axis=-1)
        unexpected = velocity - memory.expected
        force = memory.force + TRUST * unexpected / prediction.push[:, None]
        specimens = carried @ np.swapaxes(prediction.carry, 1, 2)
        return replace(
            memory,
            commands=np.where(begins[:, None], 0.0, memory.commands),
            velocity=velocity,
            specimens=np.where(begins[:, None], 0.0, specimens),
            force=np.where(begins, 0.0, force),
        )

    def _limit(
        self, memory: Memory, estimate: Estimate, misfit: FloatArray, wanted: FloatArray
    ) -> tuple[FloatArray, Memory, FloatArray]:
        """Return the actions (N,) that are sent in place of those `wanted`, the memory, the queue."""
        prediction, full = self.prediction, self.scenario.current_limit
        table = estimate.table
        z = self._state(memory, table)
        across = z.astype(np.float32) @ prediction.rows
        margin = DEVIATIONS * estimate.deviation + MISFIT * misfit
        reach = prediction.bound
        if margin.any():
            reach = reach - margin.astype(np.float32) @ self.sensitivity
        upper = (reach - across).min(axis=(0, 2)) / full
        lower = -(reach + across).min(axis=(0, 2)) / full
        brake = -np.concatenate([table, memory.commands], axis=-1) @ prediction.feedback / full
        finite = np.isfinite(wanted)
        asked = np.where(finite, wanted, 0.0).clip(-1.0, 1.0)
        failed = estimate.faulty[:, :ACTUATOR].any(axis=1)
        braking = ~finite | ~(lower <= upper) | failed
        # Where two limits contradict each other, what lies between their demands breaks each a little.
        low, high = np.minimum(lower, upper), np.maximum(lower, upper)
        sent = np.minimum(np.maximum(np.where(braking, brake, asked), low), high)
        sent = sent.clip(-self.most, self.most).astype(np.float32).astype(np.float64)  # as it leaves
        change = np.where(finite, np.abs(sent - asked), 0.0)
        current = full * sent
        expected = (z @ prediction.velocity[:, :-1, None])[:, :, 0] + prediction.velocity[
            :, -1:
        ] * current
        queue = np.concatenate([memory.commands, current[:, None]], axis=-1)
        acted = ~finite | (change > ROUNDING)
        return (
            sent,
            replace(
                memory,
                commands=queue[:, 1:],
                expected=expected,
                steps=memory.steps + 1,
                acted=memory.acted + acted,
                braked=memory.braked + (braking & acted),
                not_finite=memory.not_finite + ~finite,
                largest=np.maximum(memory.largest, change),
            ),
            queue,
        )

    def _flow(self, table: FloatArray) -> FloatArray:
        """Return the orifice's departure (N,) from the linear flow at x_A (N, 4) [m of spool]."""
        valve = self.scenario.nonlinearity.valve
        if not valve.flow_active:
            return np.zeros(len(table))
        spool = table[:, SPOOL_POSITION]
        flow: FloatArray = valve.opening(spool, table[:, LOAD_PRESSURE]) - spool
        return flow

    def _state(self, memory: Memory, readings: FloatArray) -> FloatArray:
        """Return z (H, N, columns) of `BrakingPrediction`."""
        flow = self._flow(readings)
        shape = memory.force.shape
        return np.concatenate(
            [
                np.broadcast_to(readings, (*shape, ACTUATOR)),
                memory.specimens,
                memory.force[:, :, None],
                np.broadcast_to(flow[:, None], (*shape, 1)),
                np.broadcast_to(memory.commands, (*shape, memory.commands.shape[-1])),
            ],
            axis=-1,
        )


def _hold_finite(
    held: HeldEntries | None, rows: NDArray[Any], begins: NDArray[np.bool_], places: NDArray[np.intp]
) -> HeldEntries:
    """Put the last finite value in place of what is not a number in `rows` (N, n); return those held."""
    if held is None:
        held = HeldEntries(np.zeros(rows.shape, np.float32), np.zeros(len(rows), dtype=np.int64))
    bad = ~np.isfinite(rows)
    faults = held.faults
    if bad.any():
        last = np.where(begins[:, None], np.float32(0.0), held.values)
        rows[bad] = last[bad]
        faults = faults + np.delete(bad, places, axis=1).any(axis=1)
    return HeldEntries(rows.astype(np.float32), faults)


def _require_readings(scenario: Scenario) -> None:
    """Raise ScenarioError unless the scenario shows x_A."""
    layout = scenario.observation
    missing = [name for name in STATE_SIGNALS if name not in layout.reading_names]
    if missing and not layout.sensing.full_state:
        needed = ", ".join(missing)
        raise ScenarioError("sensing", layout.reading_names, f"the supervisor needs {needed} too")


def _family(scenario: Scenario, mass_ratio: Uniform, frequency: Uniform) -> list[Specimen]:
    """Return specimens over the ranges: a geometric row of frequencies, each of them light and heavy."""
    nominal, uncertain = scenario.specimen, scenario.uncertainty
    ratio = nominal.mass / scenario.actuator.table_mass
    own = math.sqrt(nominal.stiffnesses[0] / nominal.masses[0]) / (2.0 * math.pi)
    masses = [mass_ratio, uncertain.mass_ratio or mass_ratio, Uniform(ratio, ratio)]
    rates = [frequency, uncertain.storey_frequency or frequency, Uniform(own, own)]
    lightest, heaviest = min(m.low for m in masses) / ratio, max(m.high for m in masses) / ratio
    slowest, fastest = min(f.low for f in rates) / own, max(f.high for f in rates) / own
    number = 1 + max(1, math.ceil(math.log(fastest / slowest) / math.log(FREQUENCY_RATIO)))
    factors = np.geomspace(slowest, fastest, number)
    pairs = [(mass, factor) for factor in factors for mass in (lightest, heaviest)]
    return [nominal.scaled(mass=mass, frequency=factor) for mass, factor in pairs]
