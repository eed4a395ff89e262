"""The Gymnasium environment of one table: thin over `Simulation`."""

from __future__ import annotations

import os
from math import isfinite
from typing import Any, Unpack

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from shake_env.errors import NumericalError, ScenarioError
from shake_env.kernels.layout import BROKEN, INFO, REWARD, TERMINATED
from shake_env.model.inputs import checked_action, checked_options, checked_seed
from shake_env.motion.targets import EpisodeMotion, Motion
from shake_env.rendering.window import FRAME_RATE, RENDER_MODES, make_view, metadata
from shake_env.scenario.limits import OBSERVATION_BOUND, REASONS
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream, episode_stream

INFO_KEYS = INFO


FloatBox = spaces.Space[NDArray[np.float32]]


class ShakeTableEnv(gymnasium.Env[NDArray[np.float32], NDArray[np.float32]]):
    """A shake table whose specimen must respond as it would in the earthquake.

    A servo-hydraulic actuator moves a table with a multi-storey specimen on it. The agent sets the
    current of the servovalve. The objective is to track a target acceleration and, above all, the base
    shear of the same specimen on real ground. Plant and objective: Gavin and Hoagg, "Control Objectives
    for Seismic Simulators", ACC 2009, with the corrections that ``docs/reproduction.md`` shows.

    ## Action

    ``Box(-1, 1, (1,), float32)``: valve current as a fraction of ``scenario.current_limit`` (0.125 A
    in the linear scenario, five times the rated current; 0.040 A in the laboratory's), held over one
    control period. What lies outside is clipped. A wrong shape or a value that is not finite raises
    ``ActionError``.

    ## Observation

    ``Box(-1000, 1000, (6 + 4 stories,), float32)``: the full state in the order below, each entry
    divided by ``scenario.plant.state_scale``, its rms (SI) in a table that tracks the unit-intensity
    target perfectly. With the Clough-Penzien high-pass the ground part has four entries, and the
    observation two more.

    | entries | meaning | SI unit |
    |---|---|---|
    | 0 | ground filter x_w | m/s |
    | 1 | ground filter x_w' | m/s^2 |
    | (2, 3) | (ground displacement, velocity: only with the high-pass) | (m, m/s) |
    | 2 | load pressure p_l | Pa |
    | 3 | table displacement x_a | m |
    | 4 | table velocity v_a | m/s |
    | 5 | valve spool position x_v | m |
    | 6 ... | specimen: displacement of each floor relative to the table, then velocities | m, m/s |
    | 6 + 2 stories ... | reference specimen on real ground, likewise | m, m/s |

    Where the scenario has sensors (``sensing="laboratory"`` or a ``Sensing``), their readings take the
    place of table, specimen and reference: the ground part is followed by one entry a reading, each over
    ``scenario.observation.reading_scale``. After that come, where the scenario shows them, the target
    acceleration at the coming samples of the preview (over its unit-intensity rms), the action of the
    last period, and the readings and actions of earlier periods. ``scenario.observation`` says where
    each part lies, and names every entry with its unit.

    ## Reward

    Minus the stage cost of the control period: the mean over its physics steps, taken after each, of
    ``w_a (y_A - y~)^2 / ||G_W||^2 + w_f (f_s - f~_s)^2 / ||f~_s||^2``, plus ``w_u (u / 25 mA)^2``, with
    weights 1, 1 and 0.01 by default; ``objective=Objective.raw(q_1, q_2, r)`` gives the paper's raw
    weights. Breaking a limit costs five times what a motionless table would be expected to pay over the
    rest of filtered noise of that amplitude or of 1, whichever is more (``limit_cost`` in ``info``; most
    records are weaker, and lose more by it), so that ending an episode never pays. Coming close to a
    limit costs where the scenario has soft ones (``soft_limit_cost``).

    What the scenario's reference controller and zero current get, as means over 64 earthquakes of
    filtered noise (seeds 0 to 63) of 10 s, which are 2000 control periods:

    | scenario | controller | reward per step | return per episode |
    |---|---|---|---|
    | linear | lqr | -0.2088 | -417.6 |
    | linear | none | -2.017 | -4035 |
    | laboratory | lqg | -0.002029 | -4.059 |
    | laboratory | none | -0.08243 | -164.9 |

    In ``linear`` no controller has a higher expected reward than LQR's, -0.2085 per step in the
    stationary state. White noise of standard deviation 1, with which SB3's PPO begins, gets about -30000
    per step: see ``docs/howto/train_with_sb3.md``.

    ## Start and end

    Table and specimen start at rest, with the motion at its beginning. ``truncated`` at the end of the
    motion. ``terminated`` when a limit is broken; ``info["broken_limit"]`` names it. In the linear
    scenario limits are off and only divergence (a scaled state outside the observation's bounds) ends
    an episode; ``limits="laboratory"`` switches on stroke, velocity, pressure and the accelerations of
    table and specimen (``Limits`` has one on the current, too).

    ## Info

    After each step, at the end of the control period and in SI: ``table_acceleration``,
    ``target_acceleration`` [m/s^2], ``base_shear``, ``reference_base_shear`` [N], ``current`` [A],
    ``table_displacement`` [m], ``table_velocity`` [m/s], ``load_pressure`` [Pa]; and the cost terms of
    the period ``acceleration_cost``, ``force_cost``, ``current_cost``, ``limit_cost``,
    ``soft_limit_cost`` [-].

    ## Arguments

    ``scenario``: ``"linear"`` (default), ``"as-printed"``, ``"laboratory"``, ``"unknown-specimen"``,
    ``"yielding"``, ``"field"``, ``"records"``, or a ``Scenario``. Any of its parts can be changed by a
    keyword: ``stories``, ``mass_ratio``, ``storey_frequency``, ``damping_ratio``,
    ``specimen``, ``equations``, ``physics_step``, ``control_rate``, ``acceleration_weight``,
    ``force_weight``, ``current_weight``, ``objective``, ``motion``, ``record``, ``amplitude``,
    ``duration``, ``time_compression``, ``highpass_frequency``, ``current_limit``, ``limits``,
    ``nonlinearity``, ``delay``, ``uncertainty``, ``sensing``,
    ``table``; and any field by its path in ``fields``,
    as in ``fields={"nonlinearity.friction.coulomb": 300.0}`` (see ``make_scenario``).
    ``reset(options={"motion": ...})`` takes another motion for one episode.

    ## Rendering

    ``render_mode="rgb_array"``: ``render()`` returns a frame (480, 640, 3) of uint8, read-only: the
    table and its actuator, the specimen, the reference on real ground, and the last four seconds of
    what is tracked. ``render_mode="human"`` shows them in a window, in real time. A new frame is drawn
    ``frame_rate`` (30) times a second of simulated time; in between, ``render()`` returns the last one
    again. ``metadata["render_fps"]`` is the control rate, at which a frame for every step plays in real
    time. Needs the extra ``render``: in the project's folder ``pip install '.[render]'``; see
    ``docs/rendering.md``.

    ## Versions

    v0: first release.
    """

    # Declared as an instance variable by Gymnasium; the rate of the default scenario.
    metadata = {"render_modes": RENDER_MODES, "render_fps": 200}  # noqa: RUF012

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Scenario = "linear",
        *,
        render_mode: str | None = None,
        frame_rate: float = FRAME_RATE,
        **overrides: Unpack[Overrides],
    ) -> None:
        self.scenario = make_scenario(scenario, overrides)
        self.render_mode, self.metadata = render_mode, metadata(self.scenario)
        self._view = make_view(self.scenario, render_mode, frame_rate)
        self.observation_space, self.action_space = single_spaces(self.scenario)
        self._simulation = Simulation(self.scenario, lanes=1)
        self._running = False

    @property
    def motion(self) -> EpisodeMotion:
        """The motion of the episode."""
        motion: EpisodeMotion = self._simulation.motions[0]
        return motion

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; ``options={"motion": ...}`` sets its motion.

        With a seed the episode is the protocol's earthquake of that seed: motion, drawn plant and noise.

        Returns
        -------
        observation, info
            The scaled state (n,) and the info of a table at rest.
        """
        motion = motion_option(options)
        seed = checked_seed(seed)
        super().reset(seed=seed)
        stream = episode_stream(self.np_random) if seed is None else earthquake_stream(seed)
        observation = self._simulation.start([0], [stream], None if motion is None else [motion])
        self._running = True
        if self._view is not None:
            self._view.start(motion)
        return observation[0], dict.fromkeys(INFO_KEYS, 0.0)

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold `action` (1,) for one control period.

        Raises
        ------
        ActionError
            If the action has another shape or is not finite.
        ScenarioError
            If no episode is running.
        """
        if not self._running:
            raise ScenarioError("step()", "no episode is running", "call reset() first")
        step = self._simulation.engine.step_alone if self._view is None else self._shown_step
        observation, report, ended = step(single_action(action))
        info, reward = step_info(report), report[REWARD]
        if ended == 0:
            return observation, reward, False, False, info
        self._running = False
        if ended == TERMINATED:
            refuse_overflow(reward)
            info["broken_limit"] = REASONS[int(report[BROKEN]) - 1]
        return observation, reward, ended == TERMINATED, ended != TERMINATED, info

    def _shown_step(self, action: float) -> tuple[NDArray[np.float32], list[float], int]:
        """Step as `Engine.step_alone` does, and keep what a picture shows."""
        result = self._simulation.step(np.array([action]))
        assert self._view is not None  # the caller asked
        self._view.record(result)
        return result.observation[0], result.report[:, 0].tolist(), result.ended

    def render(self) -> NDArray[np.uint8] | None:
        """Return the frame (480, 640, 3) that stands; None with a window or without a render mode.

        Raises
        ------
        ScenarioError
            If no episode has been started.
        """
        if self._view is None or self.render_mode != "rgb_array":
            return None
        return self._view.frame()

    @property
    def episode_duration(self) -> float:
        """Length of the running episode's motion, in whole control periods [s]."""
        return int(self._simulation.episode_steps[0]) * self.scenario.control_period

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._view is not None:
            self._view.close()


def step_info(report: list[float]) -> dict[str, Any]:
    """Return the info dictionary of an environment's step from its report (15,)."""
    # Written out: dict(zip(INFO_KEYS, report)) takes twice as long, a tenth of a step.
    (
        table_acceleration, target_acceleration, base_shear, reference_base_shear, current,
        table_displacement, table_velocity, load_pressure, acceleration_cost, force_cost, current_cost,
        limit_cost, soft_limit_cost, _, _,
    ) = report  # fmt: skip
    return {
        "table_acceleration": table_acceleration,
        "target_acceleration": target_acceleration,
        "base_shear": base_shear,
        "reference_base_shear": reference_base_shear,
        "current": current,
        "table_displacement": table_displacement,
        "table_velocity": table_velocity,
        "load_pressure": load_pressure,
        "acceleration_cost": acceleration_cost,
        "force_cost": force_cost,
        "current_cost": current_cost,
        "limit_cost": limit_cost,
        "soft_limit_cost": soft_limit_cost,
    }


def single_action(action: Any) -> float:
    """Return the number in an environment's `action` (1,).

    Raises
    ------
    ActionError
        If the action has another shape or is not finite.
    """
    if type(action) is np.ndarray and action.dtype.kind in "fiub":
        try:
            (value,) = action.tolist()
            if isfinite(value):
                return float(value)
        except (TypeError, ValueError):  # another shape or type: refused below
            pass
    return float(checked_action(action, (1,))[0])


def refuse_overflow(reward: float) -> None:
    """Raise NumericalError if the last reward of a table is no finite number."""
    if not isfinite(reward):
        raise NumericalError(
            "reward", reward, "a table left the range of numbers within one period: shorten physics_step"
        )


def refuse_rendering(render_mode: str | None) -> None:
    """Raise ScenarioError unless no rendering is asked for."""
    if render_mode is not None:
        raise ScenarioError(
            "render_mode", render_mode, "a batch of tables is not drawn: watch one ShakeTableEnv"
        )


def single_spaces(scenario: Scenario) -> tuple[FloatBox, FloatBox]:
    """Return the observation and action space of one table."""
    size = (scenario.observation.size,)
    bound = OBSERVATION_BOUND
    observation: Any = spaces.Box(-bound, bound, size, np.float32)
    action: Any = spaces.Box(-1.0, 1.0, (1,), np.float32)
    return observation, action


def motion_option(options: dict[str, Any] | None) -> Motion | None:
    """Return the motion that reset's options name, or None.

    Raises
    ------
    ScenarioError
        If there is another option, or the motion is none.
    """
    motion = checked_options(options, ("motion",)).get("motion")
    if motion is not None and not isinstance(motion, Motion):
        raise ScenarioError("motion", motion, "must be a FilteredNoise, a RecordedMotion or a MotionSet")
    return motion
