"""What a Kalman filter believes of a table: the nominal discrete model, its errors and its sensors.

The current is known to whoever commanded it, so that commands under way are inputs of the filter, never
states. Estimated are ``[x_A, x_S]``, a force on the table and a flow through the valve that the linear
plant leaves out (first-order Gauss-Markov processes: friction, orifice, an unlike specimen), the outputs
of the sensors' low-passes, and their offsets. Process noise is that of the continuous disturbances,
integrated exactly over a period; a rounded reading has the variance ``resolution^2 / 12`` on top of its
noise (Widrow and Kollar, Quantization Noise, 2008). Everything is in the units of an observation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import block_diag

from shake_env.dynamics.low_pass import STATE_SIGNALS
from shake_env.dynamics.nonlinear import (
    FLOW,
    FORCE,
    arrival,
    commands_under_way,
    controlled_plant,
    controlled_scale,
    floor_rows,
)
from shake_env.model.discretization import noise_covariance, zero_order_hold
from shake_env.model.nonlinearity import Nonlinearity, Yielding
from shake_env.model.parameters import FloatArray, require_non_negative, require_positive
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, StateSpace
from shake_env.motion.targets import EpisodeMotion, FilteredNoise, MotionSet, target_history
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.sensors import Measurement

# An observation is float32 and of the order of 1: no reading is better than this, noise or none.
ROUNDING = 1e-6
DISTURBANCES = 2  # [force, flow], behind [x_A, x_S]


@dataclass(frozen=True, kw_only=True)
class ModelError:
    """What the linear nominal plant leaves out, as the filter believes it.

    Each is a first-order Gauss-Markov process: stationary rms and correlation time.

    Raises
    ------
    ParameterError
        If an rms is negative or a time not above zero.
    """

    force: float  # [N] rms of a force on the table
    flow: float  # [m] rms of a spool position whose flow is missing
    force_time: float = 0.2  # [s]
    flow_time: float = 0.2  # [s]
    bias_time: float = 60.0  # [s] in which a sensor's offset wanders by its own size

    def __post_init__(self) -> None:
        require_non_negative(self, "force", "flow")
        require_positive(self, "force_time", "flow_time", "bias_time")

    @classmethod
    def from_scenario(cls, scenario: Scenario, share: float = 0.02) -> ModelError:
        """Return what a scenario's nominal model makes plausible.

        The force is the nominal Coulomb (or static) friction, and `share` of the rms force on a table
        that follows the motion; the flow is `share` of that table's. Friction keeps its sign between
        two reversals of the table: for a Gaussian velocity these are ``pi sigma_v / sigma_a`` apart
        (Rice), and the correlation time of a random telegraph signal is half of that.

        Parameters
        ----------
        share
            [-] of force and flow that no model of a table gets right.
        """
        actuator, layout = scenario.plant.actuator, scenario.plant.layout
        scale = scenario.plant.state_scale[layout.controlled]
        size = share * _motion_size(scenario)
        friction = scenario.nonlinearity.friction
        omega = scenario.ground.omega  # sigma_a / sigma_v of the target without its high-pass
        return cls(
            force=math.hypot(
                max(friction.coulomb, friction.static or 0.0),
                size * scale[LOAD_PRESSURE] * actuator.piston_area,
            ),
            flow=float(size * scale[SPOOL_POSITION]),
            force_time=math.pi / (2.0 * omega),
            flow_time=math.pi / (2.0 * omega),
        )


def _motion_size(scenario: Scenario) -> float:
    """Return the rms of the target, the strongest of a set's, over the unit-intensity one's."""

    def size(motion: EpisodeMotion) -> float:
        if isinstance(motion, FilteredNoise):
            return motion.amplitude
        target = target_history(motion, scenario.physics_step).acceleration
        return float(np.sqrt(np.mean(target**2) / scenario.plant.target_variance))

    motion = scenario.motion
    return max(map(size, motion.scaled if isinstance(motion, MotionSet) else (motion,)))


@dataclass(frozen=True)
class EstimatorModel:
    """One control period as the filter sees it, in observation units.

    States ``[x_A, x_S, force, flow, low-passes, offsets]``, n in all. Inputs are the
    actions of the periods that still act, oldest first.

    `ahead` gives the state when the next action begins to act. With ``p_l + force / A_p`` and
    ``x_v + flow`` in the places of p_l and x_v, a table under slow disturbances obeys the equations of
    the undisturbed one; if the law is to accommodate the disturbances, it is shown these. A law that
    is shown p_l itself takes the pressure that overcomes friction for inertia and yields to it: that
    makes the table compliant.
    """

    A: FloatArray  # (n, n)
    B: FloatArray  # (n, commands + 1) of the actions u_(k-1-commands) ... u_(k-1)
    C: FloatArray  # (s, n) readings at the period's end
    Q: FloatArray  # (n, n) covariance of the process noise
    R: FloatArray  # (s,) variance of the readings' noise
    start: FloatArray  # (n, n) covariance at the start of an episode: at rest, offsets unknown
    ahead: FloatArray  # (c, n + commands) from estimate and actions under way to a law's [x_A, x_S]

    @property
    def order(self) -> int:
        """Length n of the estimate."""
        return int(self.A.shape[0])

    @property
    def commands(self) -> int:
        """Earlier actions that still act in a period."""
        return int(self.B.shape[1]) - 1

    @classmethod
    def from_scenario(
        cls, scenario: Scenario, error: ModelError, *, accommodate: float = 0.0
    ) -> EstimatorModel:
        """Build the model of a scenario; one that shows the full state measures every state of it.

        Parameters
        ----------
        scenario
            Its nominal plant, delay and sensors.
        error
            What the nominal plant leaves out.
        accommodate
            Share of the disturbances that `ahead` takes out of the state: 0 none, 1 all.

        Raises
        ------
        ScenarioError
            If the equations are not the corrected ones.
        """
        table = _disturbed(scenario, error)
        A, B, Q, ahead = _period(scenario, table)
        sensors = _Sensors.from_scenario(scenario, table)
        biased = np.flatnonzero(sensors.bias > 0.0)
        x, b = len(A), len(biased)
        n = x + b
        keep = math.exp(-scenario.control_period / error.bias_time)
        C, start = np.zeros((len(sensors.rows), n)), np.zeros((n, n))
        C[:, :x] = sensors.rows
        C[biased, x + np.arange(b)] = 1.0
        start[x:, x:] = np.diag(sensors.bias[biased] ** 2)
        controlled = scenario.plant.layout.controlled.stop - scenario.plant.layout.controlled.start
        relieved = ahead[:controlled].copy()
        hidden = ahead[controlled : controlled + DISTURBANCES]
        relieved[[LOAD_PRESSURE, SPOOL_POSITION]] += accommodate * hidden
        reach = np.insert(relieved, [x] * b, 0.0, axis=1)
        return cls(
            A=block_diag(A, keep * np.eye(b)),
            B=np.vstack([B, np.zeros((b, B.shape[1]))]),
            C=C,
            Q=block_diag(Q, np.zeros((b, b))) + (1.0 - keep**2) * start,
            R=sensors.variance,
            start=start,
            ahead=reach,
        )


@dataclass(frozen=True)
class _Sensors:
    """Readings over their scale as the filter models them."""

    rows: FloatArray  # (s, x) of the signals on ``[x_A, x_S, disturbances, low-passes]``
    bias: FloatArray  # (s,) rms
    variance: FloatArray  # (s,) of the white noise

    @classmethod
    def from_scenario(cls, scenario: Scenario, table: StateSpace) -> _Sensors:
        x, layout, plant = table.order, scenario.observation, scenario.plant
        if scenario.sensing.full_state:
            s = x - DISTURBANCES
            return cls(np.eye(s, x), np.zeros(s), np.full(s, ROUNDING**2))
        measurement = Measurement.from_scenario(scenario)
        scale = plant.state_scale[plant.layout.controlled]
        # The signals of a batch of states, one for each entry, are the rows.
        f = len(layout.low_passes)
        states = np.pad(np.diag(scale), ((0, DISTURBANCES + f), (0, 0)))
        floors = states[:, 4:] @ floor_rows(plant, Yielding()).T
        behind = {each.signal: i for i, each in enumerate(layout.low_passes)}
        plain = [STATE_SIGNALS.get(name, -1) for name in layout.reading_names]
        unfiltered = replace(measurement, places=np.array(plain, dtype=int))
        rows = unfiltered.signals(states, table.C[0], table.C[1], floors).T
        for row, name, size in zip(rows, layout.reading_names, measurement.scale, strict=True):
            if name in behind:
                row[:] = 0.0
                row[x - f + behind[name]] = size
        noise = layout.sensor_values("noise") ** 2 + layout.sensor_values("resolution") ** 2 / 12.0
        return cls(
            rows / measurement.scale[:, None],
            layout.sensor_values("bias") / measurement.scale,
            noise / measurement.scale**2 + ROUNDING**2,
        )


def _disturbed(scenario: Scenario, error: ModelError) -> StateSpace:
    """Return the continuous plant on ``[x_A, x_S, force, flow, low-passes]``, in observation units.

    Inputs ``[u, w_force, w_flow]``: the action and unit white noises; outputs ``[y_A, f_s]`` in SI.
    """
    plant = scenario.plant
    low_passes = scenario.observation.low_passes
    base = controlled_plant(plant, Nonlinearity(), low_passes)
    n, m = base.order, base.order + DISTURBANCES
    scale = controlled_scale(plant, Nonlinearity(), low_passes)
    # In units of the rms force on a table that tracks perfectly, and of its spool.
    sizes = np.array([scale[LOAD_PRESSURE] * plant.actuator.piston_area, scale[SPOOL_POSITION]])
    A, B, C = np.zeros((m, m)), np.zeros((m, 3)), np.zeros((2, m))
    inputs = base.B[:, [1 + FORCE, 1 + FLOW]] * sizes
    A[:n, :n] = base.A * scale / scale[:, None]
    A[:n, n:] = inputs / scale[:, None]
    B[:n, 0] = base.B[:, 0] * scenario.current_limit / scale
    C[:, :n], C[:, n:] = base.C * scale, base.D[:, [1 + FORCE, 1 + FLOW]] * sizes
    for i, (rms, time) in enumerate(((error.force, error.force_time), (error.flow, error.flow_time))):
        A[n + i, n + i] = -1.0 / time
        B[n + i, 1 + i] = math.sqrt(2.0 / time) * rms / sizes[i]
    first = n - len(low_passes)
    order = np.r_[:first, n:m, first:n]  # the disturbances before the low-passes
    return StateSpace(A[np.ix_(order, order)], B[order], C[:, order], np.zeros((2, 3)))


def _period(
    scenario: Scenario, table: StateSpace
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return A, B, Q of one control period, and the map ahead over the loop delay.

    The map takes ``[x, u_(k-commands) ... u_(k-1)]`` to the state when u_k begins to act.
    """
    k, delay, dt = scenario.substeps, scenario.delay, scenario.physics_step
    n, commands = table.order, commands_under_way(delay, k)
    unit = np.ones(n)
    driven = StateSpace(table.A, table.B[:, :1], table.C, table.D[:, :1])
    step = zero_order_hold(driven, dt, unit)
    picks = arrival(delay, k, commands)
    running = np.eye(n, n + commands + 1)
    for pick in picks:
        running = step.A @ running
        running[:, n:] += step.B * pick
    Q = noise_covariance(table.A, table.B[:, 1:], k * dt, unit)
    # Up to the delay's end only commands given before act.
    whole, fraction = math.floor(delay), delay - math.floor(delay)
    ahead = np.eye(n, n + commands + 1)
    for j in range(whole):
        passed = j // k
        acting = np.append(np.zeros(passed), picks[j % k])[: commands + 1]
        ahead = step.A @ ahead
        ahead[:, n:] += step.B * acting
    if fraction:
        part = zero_order_hold(driven, fraction * dt, unit)
        ahead = part.A @ ahead
        ahead[:, n + commands - 1] += part.B[:, 0]
    return running[:, :n], running[:, n:], Q, ahead[:, :-1]
