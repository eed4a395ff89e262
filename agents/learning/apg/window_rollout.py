"""N tables in torch over a window of control periods, so that a cost can be differentiated through them.

Ground, previews and sensor noise come from the environment's own numpy streams, computed ahead for the
window and moved once. What the tables pass on from window to window is data: gradients end there.

A policy without memory is followed in numpy, with a reverse sweep of its own (`closed_loop`), where the
plant's adjoint is compiled or the plant is linear. Everything else is taken apart by torch, which is
also what the sweep is tested by. There a long window can be followed in segments that are run again when
its gradient is taken (Griewank and Walther, Evaluating Derivatives, 2008, ch. 12; Chen et al., 2016).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.checkpoint import checkpoint

from agents.learning.apg.closed_loop import ClosedLoop, Start
from agents.learning.apg.loop_gradient import Act, Kept, differentiable, policy_correction
from agents.learning.apg.plant_period import period_of
from agents.learning.apg.torch_plant import torch_model
from agents.learning.vec_env import ShakeTableVecEnv
from shake_env.dynamics.ground import GroundPeriod
from shake_env.dynamics.linear import PeriodResponse, as_like
from shake_env.errors import ScenarioError
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.observation import FLOOR_ACCELERATIONS
from shake_env.simulation.sensors import SensorMemory
from shake_env.simulation.transition import TableModel

# A segment draws no random number. The other way of torch's refuses `torch.autograd.grad`.
SEGMENT: dict[str, Any] = {"use_reentrant": False, "preserve_rng_state": False}
RESULTS = 3  # of a segment: costs, codes and what was put aside; then come what stands behind it


@dataclass(frozen=True)
class Window:
    """What N tables did over H control periods.

    A lane whose episode ends before the window does (its motion ends, or it breaks a limit) is stepped
    on, for nothing: past `ends` its rewards are zero.
    """

    rewards: torch.Tensor  # (H, N) times the environment's reward scale; carries the gradient
    observation: torch.Tensor  # (N, n) at the window's end; carries the gradient
    shown: torch.Tensor  # (N, n + e) with what a law behind an estimator believes behind it
    ends: torch.Tensor  # (N,) control periods that count, 1 to H
    terminated: torch.Tensor  # (N,) a limit was broken at `ends`
    steps: NDArray[np.int_]  # (N,) `ends` in numpy
    returns: NDArray[np.float64]  # (N,) sum of the true rewards
    broken: NDArray[np.int_]  # (N,) code of the broken limit, or 0
    state: torch.Tensor  # (N, states) at the window's end
    memory: SensorMemory  # then
    law_memory: Kept  # (N, M) of that law then, before it sees the observation
    recalled: Kept  # (N, units) the policy's memory then
    aside: Kept  # (H, N, ...) what the policy put aside; None where it has no memory
    history: Kept  # (H + 1, N, n + e) what was shown, of a policy without memory; carries the gradient


@dataclass(frozen=True)
class _Ahead:
    """What is known of a window before it is followed, unchanged when a part of it is run again."""

    model: TableModel
    age: NDArray[np.int_]  # (N,) periods since the start of the episodes, at the window's start
    ground: GroundPeriod  # (H, N, ...)
    noise: torch.Tensor  # (H, N, s) of the sensors


class WindowRollout:
    """The tables of an environment, followed in torch.

    Parameters
    ----------
    env
        Whose tables, streams, base law and reward scale they are.
    device
        Of the tensors.
    dtype
        Of the plant's state. In single precision the oil column's stiffness costs about four digits.
    """

    def __init__(
        self,
        env: ShakeTableVecEnv,
        *,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float64,
    ) -> None:
        if env.plan is not None:
            raise ScenarioError("base", "plan", "has no gradient: correct a linear law, or use PPO")
        self.env = env
        self.like = torch.zeros(1, dtype=dtype, device=device)
        self._base: torch.Tensor | None = as_like(env.base, self.like) if np.any(env.base) else None
        self._law = None if env.law is None else env.law.to(self.like)
        self._model: TableModel | None = None
        self._loop: ClosedLoop | None = None
        sensors = env.scenario.sensing.sensors or ()
        self._measures_floors = any(s.signal == FLOOR_ACCELERATIONS for s in sensors)

    @property
    def model(self) -> TableModel:
        """The plants as they are drawn now."""
        simulation = self.env.simulation
        if self._model is None or simulation.plant_batch is not None:
            self._model = torch_model(simulation.model, self.like)
        return self._model

    @property
    def loop(self) -> ClosedLoop | None:
        """The closed loop in numpy with the plants as they are drawn now; None where torch is needed."""
        env, simulation = self.env, self.env.simulation
        if self.like.dtype != torch.float64 or self.like.device.type != "cpu":
            return None
        if self._loop is None or simulation.plant_batch is not None:
            period = period_of(simulation.model.dynamics)
            base = env.base if np.any(env.base) else None
            if period is not None:
                self._loop = ClosedLoop(simulation.model, period, env.law, base, env.authority)
        return self._loop

    def rollout(
        self,
        act: Act,
        steps: int,
        *,
        recalled: Kept = None,
        segment: int = 0,
        parameters: Sequence[torch.Tensor] = (),
    ) -> Window:
        """Follow the tables over `steps` control periods; :meth:`sync_env` puts the environment there.

        Parameters
        ----------
        act
            Called once a control period, in order, with the observations. With `parameters` and without
            memory it must be a function of the observation alone: it is also called for all periods.
        steps
            Control periods H of the window.
        recalled
            (N, units) the policy's memory at the window's start.
        segment
            Control periods after which only what the tables pass on is kept; a gradient runs each such
            segment again. Memory is then that of one segment and of H / segment states, least near
            sqrt(H), for one more forward pass. 0: everything is kept.
        parameters
            What `act` depends on and the sweep takes gradients along; empty, or with segments: torch
            follows the tables.
        """
        simulation = self.env.simulation
        # The sweep in numpy keeps the whole window, so that segments are torch's.
        if parameters and not segment and recalled is None and (loop := self.loop) is not None:
            return self._follow_in_numpy(loop, act, steps, parameters)
        ground, noise = self._ahead(steps)
        ahead = _Ahead(
            self.model,
            simulation.step_count.copy(),
            ground.to(self.like),
            as_like(noise, self.like),
        )
        sensors = simulation.memory.to(self.like)
        carried: tuple[Kept, ...] = (
            as_like(simulation.state, self.like),
            as_like(self.env.observation, self.like),
            torch.ones(self.env.num_envs, dtype=torch.bool, device=self.like.device),
            None if self._law is None else as_like(self.env.law_memory, self.like),
            recalled,
            *(getattr(sensors, f.name) for f in fields(SensorMemory)),
        )
        parts = []
        for first in range(0, steps, segment or steps):
            last = min(first + (segment or steps), steps)
            follow: Callable[..., tuple[Kept, ...]] = partial(self._follow, act, ahead, first, last)
            # The last segment would be run again at once.
            again = segment and last < steps and torch.is_grad_enabled()
            part = checkpoint(follow, *carried, **SEGMENT) if again else follow(*carried)
            parts.append(part[:RESULTS])
            carried = part[RESULTS:]
        cost, codes, aside = (
            None if column[0] is None else torch.cat(column) for column in zip(*parts, strict=True)
        )
        state, observation, _, law_memory, recalled, *left = carried
        assert cost is not None and codes is not None and state is not None and observation is not None
        return self._window(
            cost,
            codes,
            observation=observation,
            shown=self._look(observation, law_memory, ahead.age + steps)[0],
            state=state,
            memory=SensorMemory(*left),
            law_memory=law_memory,
            recalled=recalled,
            aside=aside,
            history=None,
        )

    def _follow_in_numpy(
        self, loop: ClosedLoop, act: Act, steps: int, parameters: Sequence[torch.Tensor]
    ) -> Window:
        simulation, law = self.env.simulation, self.env.law
        age, observation = simulation.step_count.copy(), self.env.observation.astype(float)
        shown, known = observation, self.env.law_memory
        if law is not None:
            known, believed = law.look(self.env.law_memory, observation, age)
            shown = np.concatenate([observation, believed], axis=-1)
        ground, noise = self._ahead(steps)
        start = Start(simulation.state, simulation.memory, shown, known, age)
        passage = loop.run(start, ground, noise, partial(policy_correction, act))
        state, acceleration, shear, action, history = differentiable(loop, passage, age, act, parameters)
        model = self.model
        outcome = model.judge(
            PeriodResponse(state, acceleration, shear),
            model.current_limit * action,
            ground.to(self.like),
        )
        return self._window(
            outcome.cost.total + outcome.soft_cost,
            outcome.broken,
            observation=history[-1][:, : observation.shape[1]],
            shown=history[-1],
            state=torch.from_numpy(passage.begun[-1]),
            memory=passage.sensors.to(self.like),
            law_memory=None if law is None else torch.from_numpy(passage.law),
            recalled=None,
            aside=None,
            history=history,
        )

    def _follow(
        self,
        act: Act,
        ahead: _Ahead,
        first: int,
        last: int,
        state: torch.Tensor,
        observation: torch.Tensor,
        finite: torch.Tensor,
        law_memory: Kept,
        recalled: Kept,
        *sensors: torch.Tensor,
    ) -> tuple[Kept, ...]:
        """Follow the tables from period `first` to before `last`.

        Returns
        -------
        Stage costs (S, N), codes of broken limits (S, N), what the policy put aside (S, N, ...), and
        what stands behind `last`, as it came in.
        """
        model, memory = ahead.model, SensorMemory(*sensors)
        responses: list[PeriodResponse] = []
        currents: list[torch.Tensor] = []
        aside: list[torch.Tensor] = []
        for t in range(first, last):
            shown, known = self._look(observation, law_memory, ahead.age + t)
            correction, recalled, put = act(shown, recalled)
            if put is not None:
                aside.append(put)
            action = self._action(correction, shown)
            if self._law is not None:
                law_memory = self._law.keep(known, action)
            current = model.current_limit * action
            period = _part(ahead.ground, t)
            response = model.dynamics.control_step(state, current, period.drive)
            responses.append(response)
            currents.append(current)
            # A diverged table is put to rest, so that no gradient meets an infinite number.
            finite = finite & self._finite(model, response.state)
            state = torch.where(finite[:, None], response.state, 0.0)
            reached = replace(response, state=state)
            floors = model.floors(state) if self._measures_floors else None
            observation, memory = model.look(reached, floors, period, action, memory, ahead.noise[t])
        stacked = PeriodResponse(
            *(torch.stack([getattr(r, f.name) for r in responses]) for f in fields(PeriodResponse))
        )
        ground = _part(ahead.ground, slice(first, last))
        outcome = model.judge(stacked, torch.stack(currents), ground)
        return (
            outcome.cost.total + outcome.soft_cost,
            outcome.broken,
            torch.stack(aside) if aside else None,
            state,
            observation,
            finite,
            law_memory,
            recalled,
            *(getattr(memory, f.name) for f in fields(SensorMemory)),
        )

    def sync_env(
        self, window: Window
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Put the environment at a window's end; lanes whose episode ended begin their next one.

        Returns
        -------
        Observations, which environments have just begun, and infos, as
        :meth:`ShakeTableVecEnv.advance_to` returns.
        """
        memory = {f.name: _numpy(getattr(window.memory, f.name)) for f in fields(SensorMemory)}
        observation = np.clip(_numpy(window.observation), -OBSERVATION_BOUND, OBSERVATION_BOUND)
        return self.env.advance_to(
            _numpy(window.state),
            SensorMemory(**memory),
            observation.astype(np.float32),
            steps=window.steps,
            returns=window.returns,
            broken=window.broken,
            law_memory=None if window.law_memory is None else _numpy(window.law_memory),
        )

    def _look(
        self, observation: torch.Tensor, law_memory: Kept, age: NDArray[np.int_]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Return what the policy is shown at ages (N,) of the episodes, and what the law knows then."""
        if self._law is None:
            return observation, observation
        known, believed = self._law.look(law_memory, observation, age)
        return torch.cat([observation, believed], dim=-1), known

    def _action(self, correction: torch.Tensor, shown: torch.Tensor) -> torch.Tensor:
        """Return the action within [-1, 1]."""
        action = self.env.authority * correction.to(self.like.dtype).clip(-1.0, 1.0)
        if self._base is None:
            return action
        return (shown @ self._base + action).clip(-1.0, 1.0)

    @staticmethod
    @torch.no_grad()
    def _finite(model: TableModel, state: torch.Tensor) -> torch.Tensor:
        first = model.filter_states
        bound = OBSERVATION_BOUND * model.observation_scale[first : first + model.controlled]
        inside: torch.Tensor = state[:, : model.controlled].abs() <= bound
        inside[:, TABLE_DISPLACEMENT] = True  # it may drift
        return inside.all(dim=-1)

    def _window(
        self,
        cost: torch.Tensor,
        codes: torch.Tensor,
        **stands: Any,
    ) -> Window:
        simulation, scale = self.env.simulation, self.env.reward_scale
        broken = codes.cpu().numpy()  # (H, N)
        steps, lanes = broken.shape
        ever = broken != 0
        breaks = np.where(ever.any(axis=0), ever.argmax(axis=0) + 1, steps + 1)
        left = np.minimum(simulation.episode_steps - simulation.step_count, steps)
        terminated = breaks <= left
        ends = np.where(terminated, breaks, left)
        last = (ends - 1, np.arange(lanes))
        extra = np.zeros((steps, lanes))  # what broken limits cost: data, without a gradient
        extra[last] = np.where(
            terminated, simulation.termination_penalty(simulation.step_count + ends), 0.0
        )
        counts = np.arange(steps)[:, None] < ends
        running = torch.as_tensor(counts, device=self.like.device)
        total = torch.where(running, cost, 0.0) + as_like(extra, self.like)
        return Window(
            rewards=-scale * total,
            ends=torch.as_tensor(ends, device=self.like.device),
            terminated=torch.as_tensor(terminated, device=self.like.device),
            steps=ends,
            returns=-_numpy(total).sum(axis=0),
            broken=np.where(terminated, broken[last], 0),
            **stands,
        )

    def _ahead(self, steps: int) -> tuple[GroundPeriod, NDArray[np.float64]]:
        """Return ground (H, N, ...) and sensor noise (H, N, s) of the coming control periods."""
        return self.env.simulation.ground_ahead(steps)


def _part(ground: GroundPeriod, which: int | slice) -> GroundPeriod:
    parts = (getattr(ground, field.name) for field in fields(GroundPeriod))
    return GroundPeriod(*(None if part is None else part[which] for part in parts))


def _numpy(tensor: torch.Tensor) -> NDArray[np.float64]:
    array: NDArray[np.float64] = tensor.detach().cpu().numpy().astype(np.float64)
    return array
