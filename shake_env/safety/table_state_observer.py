"""Where the table is when a sensor fails: a Kalman filter over redundant readings.

The states are x_A, the force on the table that the bare table leaves out (specimen and friction, a
random walk), and the output of the accelerometer's low-pass, if it has one. The model is the linear
table over one control period, with the orifice's flow as an input. Each reading is tested against the
prediction; one that does not fit is left out, and the filter goes on with the others (Willsky,
Automatica 12, 1976). What is not known of bulk modulus, valve gain and delay widens the covariance as
the table moves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.safety.braking import ACTUATOR, bare_table
from shake_env.safety.sensor_faults import Channels
from shake_env.scenario.limits import Limits
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uniform

STATES = ACTUATOR + 1  # x_A and the force; then the output of the accelerometer's low-pass
GATE = 36.0  # [-] chi-square of all innovations, above which a reading is at fault
GAIN_ERROR = 0.2  # [-] rms error of valve gain and bulk modulus; 30 % is one and a half of it
DELAY_ERROR = 0.3  # [-] of a control period
# [-] of the full spool: error of a period's prediction where the valve is of second order; the bare
# table has its spool follow a current at first order.
SECOND_ORDER = 0.02
FORCE_STEP = 0.1  # [-] of table mass times the acceleration's limit: change of the force in a period
ROUNDING = 1e-4  # [-] of a laboratory's full scale: error of a reading without noise
START = 0.01  # [m] rms displacement of a table when an episode begins
FADING = 0.97  # [-] share of a misfit that is still counted a period later


@dataclass(frozen=True)
class ObserverMemory:
    """What the observer knows of each table; leading axis N."""

    state: FloatArray  # (N, n) predicted for now
    covariance: FloatArray  # (N, n, n)
    before: FloatArray  # (N, s) readings of the period before; NaN: none
    equal: NDArray[np.int64]  # (N, s) readings in a row that were equal
    faulty: NDArray[np.bool_]  # (N, s) readings of that period that were left out
    misfit: FloatArray  # (N, 4) recent part of the innovations of x_A that noise does not explain
    faults: NDArray[np.int64]  # (N, s) readings left out as faulty, over all episodes


@dataclass(frozen=True)
class Estimate:
    """What readings and model say of the present."""

    table: FloatArray  # (N, 4) x_A: the readings where all of them fit, else the filter's
    deviation: FloatArray  # (N, 4) rms error beyond that of the readings; 0 where all of them fit
    faulty: NDArray[np.bool_]  # (N, s) readings that were left out
    readings: FloatArray  # (N, s) what the filter expects of the sensors, SI


@dataclass(frozen=True)
class TableStateObserver:
    """The filter's matrices; n states, 5, or 6 with a low-pass."""

    channels: Channels
    size: FloatArray  # (n,) SI, of the states; in what follows they are divided by it
    unit: FloatArray  # (s,) SI, of the readings, likewise
    A: FloatArray  # (n, n) over one control period
    flow: FloatArray  # (n,) from the orifice's departure from linear flow [m of spool]
    current: FloatArray  # (n, commands + 1) from the commands, oldest first [A]
    C: FloatArray  # (s, n) readings
    R: FloatArray  # (s,) their variance
    Q: FloatArray  # (n, n)
    gain_error: float  # [-] rms relative error of the valve's gain
    delay_error: float  # [-] of a control period
    oil: FloatArray  # (n,) error that the oil's stiffness makes, for a unit change of pressure

    @classmethod
    def from_scenario(cls, scenario: Scenario) -> TableStateObserver:
        """Return the observer of a scenario's nominal table."""
        channels, actuator = Channels.from_scenario(scenario), scenario.actuator
        uncertain = scenario.uncertainty
        bare = bare_table(scenario)
        model = bare.period
        force = ACTUATOR + 2  # behind x_A and the bare table's one storey
        states = [*range(ACTUATOR), force]
        mass, area = actuator.table_mass, actuator.piston_area
        C = np.zeros((len(channels.names), STATES))
        C[:ACTUATOR, :ACTUATOR] = np.eye(ACTUATOR)
        C[ACTUATOR:, LOAD_PRESSURE] = area / mass
        C[ACTUATOR:, TABLE_DISPLACEMENT] = -actuator.table_stiffness / mass
        C[ACTUATOR:, TABLE_VELOCITY] = -actuator.table_damping / mass
        C[ACTUATOR:, -1] = 1.0 / mass
        full = Limits.laboratory()
        assert full.table_displacement and full.table_velocity
        assert full.load_pressure and full.table_acceleration
        spool = full.table_velocity * area / actuator.flow_gain
        table = [full.load_pressure, full.table_displacement, full.table_velocity, spool]
        size = np.asarray([*table, mass * full.table_acceleration])
        unit = np.asarray([*table, full.table_acceleration])[: len(C)]
        noise = channels.noise / unit + ROUNDING
        A = model[np.ix_(states, states)]
        flow, current = model[states, force + 1], model[states, force + 2 :]
        if len(C) > ACTUATOR and math.isfinite(channels.cutoff):
            start = np.zeros(bare.outputs.shape[-1])
            start[states] = C[ACTUATOR]
            stays, row = _low_pass(scenario, np.vstack([start, bare.outputs[:, ACTUATOR]]))
            A = np.block([[A, np.zeros((STATES, 1))], [row[states], np.array([[stays]])]])
            flow, current = np.append(flow, row[force + 1]), np.vstack([current, row[force + 2 :]])
            C = np.pad(C, ((0, 0), (0, 1)))
            C[ACTUATOR] = np.eye(STATES + 1)[STATES]
            size = np.append(size, full.table_acceleration)
        A = A * size / size[:, None]
        push = np.where(np.arange(len(A)) == ACTUATOR, 0.0, A[:, ACTUATOR])  # of a force held over it
        step = FORCE_STEP * (0.5 * push + np.eye(len(A))[ACTUATOR])
        second_order = scenario.nonlinearity.valve.natural_frequency is not None
        spool_error = SECOND_ORDER * second_order * np.eye(len(A))[SPOOL_POSITION]
        return cls(
            channels=channels,
            size=size,
            unit=unit,
            A=A,
            flow=flow / size,
            current=current / size[:, None],
            C=C * size / unit[:, None],
            R=np.square(noise),
            Q=np.outer(step, step) + np.diag(spool_error**2),
            gain_error=_error(uncertain.valve_gain, actuator.valve_gain),
            delay_error=_delay_error(scenario),
            oil=_error(uncertain.bulk_modulus, actuator.bulk_modulus)
            * (np.eye(len(A))[LOAD_PRESSURE] + 0.5 * push * area * size[0] / size[ACTUATOR]),
        )

    def begin(self, lanes: int) -> ObserverMemory:
        """Return the memory of tables at rest."""
        s = len(self.channels.names)
        rest = np.append(self.R[:ACTUATOR], self.Q[ACTUATOR, ACTUATOR])
        if len(self.size) > STATES:
            rest = np.append(rest, self.R[ACTUATOR])
        rest[TABLE_DISPLACEMENT] = (START / self.size[TABLE_DISPLACEMENT]) ** 2
        return ObserverMemory(
            state=np.zeros((lanes, len(self.size))),
            covariance=np.tile(np.diag(rest), (lanes, 1, 1)),
            before=np.full((lanes, s), np.nan),
            equal=np.zeros((lanes, s), dtype=np.int64),
            faulty=np.zeros((lanes, s), dtype=bool),
            misfit=np.zeros((lanes, ACTUATOR)),
            faults=np.zeros((lanes, s), dtype=np.int64),
        )

    def afresh(self, memory: ObserverMemory, begins: NDArray[np.bool_]) -> ObserverMemory:
        """Return the memory with tables at rest where an episode `begins` (N,); faults count on."""
        if not begins.any():
            return memory
        rest = self.begin(len(begins))
        parts = {
            name: np.where(begins.reshape(-1, *[1] * (value.ndim - 1)), getattr(rest, name), value)
            for name, value in vars(memory).items()
            if name != "faults"
        }
        return replace(memory, **parts)

    def look(self, memory: ObserverMemory, readings: FloatArray) -> tuple[Estimate, ObserverMemory]:
        """Weigh the readings (N, s), SI.

        Returns
        -------
        estimate, memory
            Of the present; the memory holds the filter's state and covariance with the readings in.
        """
        channels, C = self.channels, self.C
        impossible, repeated, equal = channels.incredible(readings, memory.before, memory.equal)
        # What was wrong is no better for being repeated.
        faulty: NDArray[np.bool_] = impossible | (repeated & memory.faulty)
        value = np.where(np.isfinite(readings), readings, 0.0) / self.unit
        P = memory.covariance
        innovation = value - memory.state @ C.T
        spread = P @ C.T  # (N, 5, s)
        S = C @ spread + np.diag(self.R)
        diagonal = np.arange(len(C))
        size = np.sqrt(S[:, diagonal, diagonal])
        correlation = S / (size[:, :, None] * size[:, None, :])
        while True:
            weigh = np.where(faulty, 0.0, 1.0)
            e = weigh * innovation / size
            part = weigh[:, :, None] * correlation * weigh[:, None, :]
            part[:, diagonal, diagonal] = 1.0
            W = np.linalg.inv(part)
            y = (W @ e[:, :, None])[:, :, 0]
            unlikely = (e * y).sum(axis=1) > GATE
            if not unlikely.any():
                break
            share = y**2 / W[:, diagonal, diagonal]
            worst = (share == share.max(axis=1, keepdims=True)) & unlikely[:, None]
            faulty = faulty | worst
        gain = spread * (weigh / size)[:, None, :]
        state = memory.state + (gain @ y[:, :, None])[:, :, 0]
        # Joseph's form, which rounding leaves positive.
        K = gain @ W * (weigh / size)[:, None, :]
        remaining = np.eye(len(self.size)) - K @ C
        covariance = remaining @ P @ np.swapaxes(remaining, 1, 2) + (K * self.R) @ np.swapaxes(K, 1, 2)
        fits = (faulty[:, :ACTUATOR] == 0).all(axis=1)
        variance = np.maximum(covariance[:, range(ACTUATOR), range(ACTUATOR)], 0.0)
        size = self.size[:ACTUATOR]
        unexplained = np.abs(innovation[:, :ACTUATOR]) - 3.0 * self.usual
        begins = np.isnan(memory.before[:, :ACTUATOR])  # what is read first tells nothing of the model
        unexplained = size * np.where(faulty[:, :ACTUATOR] | begins, 0.0, unexplained)
        table = np.where(fits[:, None], readings[:, :ACTUATOR], size * state[:, :ACTUATOR])
        deviation = np.where(fits[:, None], 0.0, size * np.sqrt(variance))
        expected = state @ C.T * self.unit
        return Estimate(table, deviation, faulty, expected), replace(
            memory,
            state=state,
            covariance=covariance,
            before=np.where(np.isfinite(readings), readings, memory.before),
            equal=equal,
            faulty=faulty,
            misfit=np.maximum(FADING * memory.misfit, unexplained),
            faults=memory.faults + faulty,
        )

    @cached_property
    def usual(self) -> FloatArray:
        """Rms of the innovations of x_A (4,) on the plant that is known, at rest."""
        A = self.A[:, :ACTUATOR]
        variance = np.diagonal(self.Q + (A * self.R[:ACTUATOR]) @ A.T)[:ACTUATOR]
        usual: FloatArray = np.sqrt(variance + self.R[:ACTUATOR])
        return usual

    def predict(self, memory: ObserverMemory, commands: FloatArray, flow: FloatArray) -> ObserverMemory:
        """Return the memory with state and covariance of the next period.

        Parameters
        ----------
        memory
            What `look` returned.
        commands
            (N, commands + 1) under way, oldest first, the present one last [A].
        flow
            (N,) departure of the orifice's flow from the linear one [m of spool].
        """
        A, held = self.A, commands @ self.current.T
        state = memory.state @ A.T + held + flow[:, None] * self.flow
        late = (
            self.delay_error * np.diff(commands, axis=1).sum(axis=1)[:, None] * self.current.sum(axis=1)
        )
        oil = (state - memory.state)[:, LOAD_PRESSURE, None] * self.oil
        errors = np.stack([self.gain_error * held, late, oil], axis=2)
        covariance = A @ memory.covariance @ A.T + self.Q + errors @ np.swapaxes(errors, 1, 2)
        return replace(memory, state=state, covariance=covariance)


def _low_pass(scenario: Scenario, signal: FloatArray) -> tuple[float, FloatArray]:
    """Return what stays of a low-pass's output over a period, and what a signal adds to it.

    Parameters
    ----------
    signal
        (k + 1, columns) at the period's start and after each physics step; straight between.
    """
    decay = 2.0 * math.pi * scenario.physics_step * Channels.from_scenario(scenario).cutoff
    stays, mean = math.exp(-decay), -math.expm1(-decay) / decay
    row = np.zeros(signal.shape[1])
    for before, now in pairwise(signal):
        row = stays * row + (mean - stays) * before + (1.0 - mean) * now
    return stays ** (len(signal) - 1), row


def _error(range_: Uniform | None, nominal: float) -> float:
    """Return the rms relative error of a parameter, at least `GAIN_ERROR`."""
    if range_ is None:
        return GAIN_ERROR
    widest = max(abs(end / nominal - 1.0) for end in (range_.low, range_.high))
    return max(GAIN_ERROR, widest / math.sqrt(3.0))


def _delay_error(scenario: Scenario) -> float:
    """Return the error of the loop delay [-] of a control period, at least `DELAY_ERROR`."""
    drawn = scenario.uncertainty.delay
    ends = () if drawn is None else (drawn.low, drawn.high)
    widest = max((abs(end - scenario.delay) for end in ends), default=0.0)
    return max(DELAY_ERROR, widest / scenario.substeps)
