"""The Gymnasium environment of a sequence of shakes: one specimen, rising amplitudes, damage carried."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Unpack

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from shake_env.env import (
    ShakeTableEnv,
    motion_option,
    step_info,
)
from shake_env.errors import ParameterError
from shake_env.model.inputs import checked_seed
from shake_env.model.specimen_state import NEW, SpecimenState
from shake_env.motion.targets import EpisodeMotion, control_steps
from shake_env.rendering.window import FRAME_RATE
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.overrides import Overrides
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.streams import earthquake_stream, episode_stream

AMPLITUDES = (0.1, 0.25, 0.5, 0.75, 1.0)


class ShakeTableSequenceEnv(ShakeTableEnv):
    """One specimen in a sequence of shakes of rising amplitude, an episode a sequence.

    Action, reward and limits are those of ``ShakeTableEnv``. Reset draws the specimen (and whatever
    else of the plant is uncertain) and one motion; every shake of the episode repeats that motion at
    its own amplitude on that plant. Between two shakes table and specimen come to rest and the table
    returns to the middle of its stroke; the slip of yielding storeys and the energy that they
    dissipated pass on (``shake_env.model.specimen_state``). Noise and offsets of the sensors are drawn
    for each shake, and so is filtered noise. A policy with memory can learn the specimen in the weak
    shakes for the strong ones.

    ## Observation

    That of ``ShakeTableEnv``, and one entry behind it: the amplitude of the present shake over that of
    the last one, in (0, 1]. The step that ends a shake returns the observation that the next one begins
    with, as ``reset`` would.

    ## End

    ``truncated`` at the end of the last shake. ``terminated`` when a limit is broken: the cost is that
    of ``ShakeTableEnv`` for the rest of the shake and, at the same rate, of all shakes that the
    sequence then lacks (``limit_cost`` in ``info``).

    ## Info

    That of ``ShakeTableEnv``, and of every step: ``shake``, index of the shake that the step belongs
    to, from 0; ``amplitude``, of its motion over the scenario's own; ``shake_ended``, whether it was
    the shake's last step; ``shake_costs``, minus the sum of rewards of each shake so far (a tuple, the
    present one last); ``dissipated_energy`` and ``reference_dissipated_energy`` in the first storey
    since the sequence began [J].

    ## Arguments

    ``scenario`` (default ``"unknown-specimen"``) and the keywords of ``ShakeTableEnv``;
    ``amplitudes``: of the shakes, factors on the scenario's motion, rising.
    ``reset(options={"motion": ...})`` takes another motion of amplitude 1 for one sequence.

    ## Versions

    v0: first release.
    """

    def __init__(
        self,
        scenario: str | os.PathLike[str] | Scenario = "unknown-specimen",
        *,
        amplitudes: Sequence[float] = AMPLITUDES,
        render_mode: str | None = None,
        frame_rate: float = FRAME_RATE,
        **overrides: Unpack[Overrides],
    ) -> None:
        super().__init__(scenario, render_mode=render_mode, frame_rate=frame_rate, **overrides)
        self.amplitudes = rising_amplitudes(amplitudes)
        (size,) = self.observation_space.shape or (0,)
        bound = OBSERVATION_BOUND
        self.observation_space = spaces.Box(-bound, bound, (size + 1,), np.float32)
        self._shake = 0
        self._motion: EpisodeMotion | None = None
        self._costs: list[float] = []
        self.specimen: SpecimenState = NEW  # at the start of the present shake

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Draw a specimen and begin its first shake; ``options={"motion": ...}`` sets the motion.

        Returns
        -------
        observation, info
            (n + 1,) and the info of a table at rest.
        """
        given = motion_option(options)
        seed = checked_seed(seed)
        super(ShakeTableEnv, self).reset(seed=seed)
        stream = episode_stream(self.np_random) if seed is None else earthquake_stream(seed)
        self._motion = (self.scenario.motion if given is None else given).pick(stream)
        self._shake, self._costs, self.specimen = 0, [0.0], NEW
        observation = self._begin(stream, draw=True)
        self._stream = stream
        info: dict[str, Any] = step_info([0.0] * 15)
        return observation, self._with_sequence(info, ended=False)

    def _begin(self, stream: np.random.Generator, *, draw: bool) -> NDArray[np.float32]:
        """Begin the present shake on the specimen as it is; return its observation."""
        assert self._motion is not None  # reset made it
        motion = self._at(self._shake)
        shown = self._simulation.start([0], [stream], [motion], [self.specimen], draw=draw)
        self._running = True
        self._energy, self._last = np.zeros(2), self._force_and_drift(None)
        if self._view is not None:
            self._view.start(motion)
        return self._with_amplitude(shown[0])

    def _at(self, shake: int) -> EpisodeMotion:
        assert self._motion is not None  # reset made it
        return replace(self._motion, amplitude=self.amplitudes[shake] * self._motion.amplitude)

    def _with_amplitude(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        share = self.amplitudes[self._shake] / self.amplitudes[-1]
        return np.append(observation, np.float32(share))

    def _with_sequence(self, info: dict[str, Any], *, ended: bool) -> dict[str, Any]:
        now = self.specimen.energy, self.specimen.reference_energy
        spent = np.maximum(self._energy, 0.0)
        info["shake"], info["amplitude"] = self._shake, self.amplitudes[self._shake]
        info["shake_ended"], info["shake_costs"] = ended, tuple(self._costs)
        info["dissipated_energy"] = now[0] + float(spent[0])
        info["reference_dissipated_energy"] = now[1] + float(spent[1])
        return info

    def _force_and_drift(self, info: dict[str, Any] | None) -> NDArray[np.float64]:
        """Return base shear [N] and first storey's drift [m], ``[f, f~, d, d~]`` (4,); None: at rest."""
        forces = (0.0, 0.0) if info is None else (info["base_shear"], info["reference_base_shear"])
        return np.array([*forces, *self._simulation.first_drifts[:, 0]])

    def step(
        self, action: NDArray[np.float32]
    ) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Hold `action` (1,) for one control period.

        Raises
        ------
        ActionError, ScenarioError
            As ``ShakeTableEnv.step``.
        """
        observation, reward, terminated, truncated, info = super().step(action)
        now, last = self._force_and_drift(info), self._last
        self._energy += 0.5 * (now[:2] + last[:2]) * (now[2:] - last[2:])
        self._last = now
        if terminated:
            lacking = self._cost_of_lacking_shakes()
            info["limit_cost"] += lacking
            reward -= lacking
        self._costs[-1] -= reward
        info = self._with_sequence(info, ended=terminated or truncated)
        if not truncated or self._shake + 1 == len(self.amplitudes):
            return self._with_amplitude(observation), reward, terminated, truncated, info
        self.specimen = self.specimen_now
        self._shake += 1
        self._costs.append(0.0)
        return self._begin(episode_stream(self._stream), draw=False), reward, False, False, info

    def _cost_of_lacking_shakes(self) -> float:
        """Return what a motionless table would be charged over the shakes that are not begun."""
        tables, scenario = self._simulation.tables, self.scenario
        total = 0.0
        for shake in range(self._shake + 1, len(self.amplitudes)):
            motion = self._at(shake)
            steps = control_steps(motion, scenario.control_period, scenario.physics_step)
            severity = max(1.0, motion.amplitude**2)
            total += tables.limit_rate * severity * min(float(steps), tables.limit_steps)
        return total

    @property
    def specimen_now(self) -> SpecimenState:
        """State of the specimen if the table came to rest now."""
        held, reference = self._simulation.specimens
        return self.specimen.after(held[0], reference[0], *self._energy)


def rising_amplitudes(amplitudes: Sequence[float]) -> tuple[float, ...]:
    """Return the amplitudes of a sequence of shakes as a tuple; they must rise.

    Raises
    ------
    ParameterError
        If there is none, or they do not rise from above 0.
    """
    values = tuple(map(float, amplitudes))
    pairs = zip((0.0, *values), values, strict=False)
    if not values or not all(a < b < math.inf for a, b in pairs):
        raise ParameterError("amplitudes", values, "must rise from above 0, and be finite")
    return values
