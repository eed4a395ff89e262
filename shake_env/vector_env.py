"""The Gymnasium vector environment: N tables in one batch, thin over `Simulation`."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, Unpack

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from shake_env.env import INFO_KEYS, motion_option, refuse_overflow, refuse_rendering, single_spaces
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.inputs import batch_action, checked_options, checked_seeds
from shake_env.model.parameters import FloatArray
from shake_env.model.ranges import Range, check
from shake_env.motion.targets import EpisodeMotion
from shake_env.scenario.limits import REASONS
from shake_env.scenario.overrides import Overrides, make_scenario
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.batch_info import BatchInfo
from shake_env.simulation.engine import BoolArray, LaneState, Observations, StepResult
from shake_env.simulation.memory import check_memory
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream, episode_stream, stream_array

NUM_ENVS = Range(1, 10_000_000, whole=True)
THREADS = Range(1, 1024, whole=True)
_KEYS = tuple((key, f"_{key}") for key in INFO_KEYS)  # of a value, and of whether a lane has one


class _NamesSB3Env(type):
    """Says in messages of other libraries what Stable-Baselines3 takes instead.

    SB3 rejects a Gymnasium vector environment by its type alone, before it touches any attribute of it,
    with a message that contains ``f"{type(env)}"`` and names no remedy. That text is all that can be
    changed from here; ``repr`` and ``str`` of the class stay as they are.
    """

    def __format__(cls, format_spec: str) -> str:
        return f"{cls!r} (for Stable-Baselines3 use agents.learning.make_sb3_env instead of make_vec)"


class ShakeTableVectorEnv(
    VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]], metaclass=_NamesSB3Env
):
    """N shake tables, stepped together; each lane is what `ShakeTableEnv` is alone.

    The spaces, reward, episode ends and `info` are those of ``ShakeTableEnv``, with a leading axis of
    N lanes. Lane i of ``reset(seed=s)`` repeats the single environment's ``reset(seed=s + i)`` and all
    the episodes that follow it, in any batch size. Stable-Baselines3 takes no Gymnasium vector
    environment: give it ``agents.learning.sb3_env.make_sb3_env``.

    Parameters
    ----------
    num_envs
        Number of tables N.
    scenario, overrides
        As for ``ShakeTableEnv``.
    autoreset_mode
        ``NEXT_STEP`` (default): the step after an episode's end ignores the lane's action and starts
        its next episode. ``SAME_STEP``: the ending step starts it and hands the last observation and
        info over as ``final_obs`` and ``final_info``. ``DISABLED``: the caller resets, with
        ``reset(options={"reset_mask": mask})``.
    threads
        Threads that step the tables, where there are 512 tables or more for each.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | os.PathLike[str] | Scenario = "linear",
        *,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        threads: int = 1,
        **overrides: Unpack[Overrides],
    ) -> None:
        refuse_rendering(render_mode)
        check("num_envs", num_envs, NUM_ENVS)
        check("threads", threads, THREADS)
        self.num_envs = int(num_envs)
        self.scenario = make_scenario(scenario, overrides)
        check_memory(self.scenario, self.num_envs)  # before the spaces, which hold bounds for each lane
        self.render_mode = render_mode
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = single_spaces(self.scenario)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._simulation = Simulation(self.scenario, self.num_envs, threads=int(threads))
        self._streams: list[np.random.Generator | None] = [None] * self.num_envs
        self._ended = np.ones(self.num_envs, dtype=bool)  # lanes whose episode is over
        self._some_ended = True

    @property
    def motions(self) -> list[EpisodeMotion]:
        """The motion of each lane's episode (N)."""
        return self._simulation.motions

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode in every lane, or in those of ``options["reset_mask"]`` (N,) of bool.

        Parameters
        ----------
        seed
            s for seeds s, s + 1, ..., or one a lane: the protocol's earthquakes of these seeds. None
            goes on with each lane's stream.
        options
            ``reset_mask``, and ``motion`` for the motion of all these episodes.
        """
        seeds = checked_seeds(seed, self.num_envs)
        rest = checked_options(options, ("motion", "reset_mask"))
        lanes = np.flatnonzero(self._mask(rest.pop("reset_mask", None)))
        motion = motion_option(rest)
        begun: dict[int, np.random.Generator] = {}  # streams of the episodes that a seed gives
        for lane in lanes:
            if (own := seeds[lane]) is not None:
                begun[int(lane)] = earthquake_stream(own)
            if own is not None or self._streams[lane] is None:
                self._streams[lane], _ = seeding.np_random(own)
        observation = np.zeros(self.observation_space.shape or (), dtype=np.float32)
        # Lanes that go on keep the observation they have.
        observation[:] = self._last if len(lanes) < self.num_envs else 0.0
        observation[lanes] = self._start(lanes, motion, begun)
        self._last = observation
        return observation.copy(), self._rest_info(lanes)

    _last: NDArray[np.float32] | float = 0.0

    def step(
        self, actions: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], FloatArray, BoolArray, BoolArray, dict[str, Any]]:
        """Hold `actions` (N, 1) for one control period.

        Raises
        ------
        ActionError
            If the actions have another shape or are not finite.
        ScenarioError
            If a lane's episode is over and nothing resets it.
        """
        action = batch_action(actions, (self.num_envs, 1))
        over = np.flatnonzero(self._ended) if self._some_ended else None
        if over is not None:
            unknown = any(stream is None for stream in self._streams)
            if unknown or self.autoreset_mode != AutoresetMode.NEXT_STEP:
                raise ScenarioError("lanes", over.tolist(), "their episode is over: reset() them first")
        result = self._simulation.step(action)
        observation, reward, info = result.observation, result.reward, self._info(result, over)
        terminated, truncated = result.terminated, result.truncated
        if over is not None:
            observation[over] = self._start(over, None)
            reward[over], terminated[over], truncated[over] = 0.0, False, False
        self._last = observation
        if result.ended:
            self._end(result, observation, info)
        if self.autoreset_mode == AutoresetMode.DISABLED:
            self._last = observation.copy()  # which a reset of others hands out again
        return observation, reward, terminated, truncated, info

    def get_state(self, lanes: Sequence[int] | None = None) -> LaneState:
        """Return everything that lanes go on from, arrays with one row a lane.

        Those of `Simulation.get_state`, and of the environment ``stream`` (an array of generators),
        ``ended`` and ``observation``. The rows of one lane given to another by :meth:`set_state` make it
        go on as the first, the episodes that follow included.

        Parameters
        ----------
        lanes
            Indices of the lanes; None: all N.

        Raises
        ------
        ScenarioError
            If no episode has begun.
        """
        self._require_begun()
        index = range(self.num_envs) if lanes is None else list(lanes)
        state = self._simulation.get_state(lanes)
        state["stream"] = stream_array([self._streams[lane] for lane in index])
        state["ended"] = self._ended[index].copy()
        state["observation"] = np.asarray(self._last)[index].copy()
        return state

    def set_state(self, state: Mapping[str, NDArray[Any]], lanes: Sequence[int] | None = None) -> None:
        """Put lanes where others stood; the rest goes on as it was.

        Parameters
        ----------
        state
            What :meth:`get_state` returned, of a vector environment of the same scenario.
        lanes
            Indices of the lanes that take its rows, in order; None: all N, and :meth:`reset` is then not
            needed.

        Raises
        ------
        ScenarioError
            If the state is of another scenario or of another number of lanes.
        """
        if lanes is not None:
            self._require_begun()
        index = range(self.num_envs) if lanes is None else list(lanes)
        own = ("stream", "ended", "observation")
        rest = {name: array for name, array in state.items() if name not in own}
        self._simulation.set_state(rest, lanes)
        for lane, stream in zip(index, stream_array(state["stream"]), strict=True):
            self._streams[lane] = stream
        self._ended[index] = state["ended"]
        self._some_ended = bool(self._ended.any())
        last = np.zeros(self.observation_space.shape or (), dtype=np.float32) + self._last
        last[index] = state["observation"]
        self._last = last

    def _require_begun(self) -> None:
        if any(stream is None for stream in self._streams):
            raise ScenarioError("state", None, "no episode has begun: reset() first")

    def _end(self, result: StepResult, observation: Observations, info: dict[str, Any]) -> None:
        """Note which episodes are over, and begin the next ones where the same step does."""
        done = result.terminated | result.truncated
        lanes = np.flatnonzero(done)
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            self._ended, self._some_ended = done, len(lanes) > 0
            return
        if not len(lanes):
            return
        final = np.full(self.num_envs, None, dtype=object)
        for lane in lanes:
            final[lane] = observation[lane].copy()
        final_info: dict[str, Any] = {}
        for key in INFO_KEYS:
            final_info[key], final_info[f"_{key}"] = np.where(done, info[key], 0.0), done.copy()
            info[key] = np.where(done, 0.0, info[key])  # of the table at rest that follows
        for key in ("broken_limit", "_broken_limit"):
            if key in info:
                final_info[key] = info.pop(key)
        info.update(
            final_obs=final, _final_obs=done.copy(), final_info=final_info, _final_info=done.copy()
        )
        observation[lanes] = self._start(lanes, None)

    def _start(
        self,
        lanes: NDArray[np.intp],
        motion: Any,
        begun: Mapping[int, np.random.Generator] = MappingProxyType({}),
    ) -> NDArray[np.float32]:
        """Begin episodes: of the stream that a seed has `begun`, or of the lane's next one."""
        streams = []
        for lane in lanes:
            stream = self._streams[lane]
            assert stream is not None  # reset() made it
            streams.append(begun.get(int(lane)) or episode_stream(stream))
        self._ended[lanes] = False
        self._some_ended = bool(self._ended.any())
        motions = None if motion is None else [motion] * len(lanes)
        return self._simulation.start(lanes.tolist(), streams, motions)

    def _rest_info(self, lanes: NDArray[np.intp]) -> dict[str, Any]:
        info: dict[str, Any] = {}
        for key in INFO_KEYS:
            info[key], info[f"_{key}"] = np.zeros(self.num_envs), np.zeros(self.num_envs, dtype=bool)
            info[f"_{key}"][lanes] = True
        return info

    def _info(self, result: StepResult, restarted: NDArray[np.intp] | None) -> dict[str, Any]:
        if restarted is None and not result.ended:
            return BatchInfo(result.report)
        report, terminated = result.report[: len(INFO_KEYS)], result.terminated
        if restarted is not None:
            report, terminated = report.copy(), terminated.copy()
            report[:, restarted], terminated[restarted] = 0.0, False
        info: dict[str, Any] = {}
        masks = np.ones(report.shape, dtype=bool)
        for (key, mask_key), value, mask in zip(_KEYS, report, masks, strict=True):
            info[key], info[mask_key] = value, mask
        if terminated.any():
            refuse_overflow(float(result.reward[terminated].sum()))
            names = np.array([None, *REASONS], dtype=object)
            info["broken_limit"] = names[np.where(terminated, result.broken, 0.0).astype(int)]
            info["_broken_limit"] = terminated
        return info

    def _mask(self, mask: BoolArray | None) -> BoolArray:
        if mask is None:
            return np.ones(self.num_envs, dtype=bool)
        if not isinstance(mask, np.ndarray) or mask.dtype != bool or mask.shape != (self.num_envs,):
            raise ParameterError(
                "reset_mask", mask, f"must be an array of bool, shape ({self.num_envs},)"
            )
        if not mask.any():
            raise ParameterError("reset_mask", mask, "must pick at least one lane")
        return mask
