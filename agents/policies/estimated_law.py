"""A linear law behind a Kalman filter, as matrices: what a policy can correct, in torch and from a file.

`baselines.estimation.lqg.EstimatedState` with a linear law is linear in all that it has seen; only the
filter's gain depends on the time since the start. Here a period of it is two products and the gain. A
policy is shown what the estimator believes, and a gradient through the plant goes through the estimator
as well.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import array_api_compat
import numpy as np
from numpy.typing import NDArray

from baselines.estimation.lqg import EstimatedState
from baselines.lqr.preview import PreviewFeedback
from baselines.registry import make_baseline
from shake_env.dynamics.linear import as_like
from shake_env.errors import ScenarioError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario

Array = Any  # a numpy array or a torch tensor


@dataclass(frozen=True)
class EstimatedLaw:
    """A linear law on an estimate, and what it shows of it.

    The memory is ``[estimate, actions, x_W, x~_S]`` in observation units, actions oldest first. A
    period is

    ``[known, innovation] = advance [memory, observation]``, ``estimate += gain innovation``,
    ``shown = show [known, observation]``.

    Shown is ``[x_W, x_A, x_S, x~_S]`` over its scale, as believed for the instant at which the action
    begins to act, the disturbances (force and flow) as estimated, and last the law's own action.
    """

    advance: Array  # (M + s, M + n)
    gains: Array  # (periods, estimates, s); the last one serves ever after
    show: Array  # (e, M + n)
    begins: Array  # (M + s,) 0 for what is unknown at an episode's start, else 1
    actions: int  # own actions remembered

    @classmethod
    def from_name(
        cls, name: str, scenario: Scenario, parameters: Mapping[str, float] | None = None
    ) -> EstimatedLaw:
        """Return the law of a controller's name, as `make_baseline` designs it.

        Its `parameters` are those of these; None takes what was tuned for exactly this scenario.

        Raises
        ------
        ScenarioError
            If that is no linear law on an estimate.
        """
        controller = make_baseline(name, scenario, parameters)
        if not isinstance(controller, EstimatedState) or not isinstance(controller.law, PreviewFeedback):
            raise ScenarioError("base", name, "is no linear law behind an estimator on this scenario")
        return _matrices(scenario, controller, controller.law.row)

    @property
    def size(self) -> int:
        """Length M of the memory."""
        return int(self.show.shape[1]) - self.observation_size

    @property
    def observation_size(self) -> int:
        """Length n of the observation that it reads."""
        readings, rows = self.gains.shape[2], self.advance.shape[0]
        return int(self.advance.shape[1] - (rows - readings))

    @property
    def shown(self) -> int:
        """Number e of entries that it shows."""
        return int(self.show.shape[0])

    def reading(self, places: NDArray[np.intp], size: int) -> EstimatedLaw:
        """Return this law as it reads an observation (..., size) whose `places` (n,) are its own."""
        first = self.size
        columns = np.concatenate([np.arange(first), first + places])
        parts: dict[str, Any] = {}
        for name in ("advance", "show"):
            matrix = getattr(self, name)
            parts[name] = np.zeros((len(matrix), first + size))
            parts[name][:, columns] = matrix
        return replace(self, **parts)

    def to(self, array: Array) -> EstimatedLaw:
        """Return this law in the library, precision and device of `array`."""
        moved = {f.name: as_like(getattr(self, f.name), array) for f in fields(self)[:-1]}
        return replace(self, **moved)

    def look(self, memory: Array, observation: Array, age: Any) -> tuple[Array, Array]:
        """Weigh the readings of an observation.

        Parameters
        ----------
        memory
            (..., M) what :meth:`keep` returned, zeros at the start of an episode.
        observation
            (..., n)
        age
            (...) integer array of numpy: periods since the start of the episode.

        Returns
        -------
        known, shown
            (..., M) for :meth:`keep`, and (..., e).
        """
        if not (isinstance(memory, np.ndarray) and isinstance(observation, np.ndarray)):
            return self._weigh(memory, observation, age)
        age = np.asarray(age)
        early = age < len(self.gains) - 1  # whose gains still change
        if early.all():
            return self._weigh_early(memory, observation, age)
        both = np.concatenate([memory, observation], axis=-1) @ self._settled.T
        known, shown = both[..., : self.size], both[..., self.size :]
        if early.any():
            parts = self._weigh_early(memory[early], observation[early], age[early])
            known[early], shown[early] = parts
        return known, shown

    @cached_property
    def _settled(self) -> FloatArray:
        """``[known, shown]`` from ``[memory, observation]`` with the last gain, (M + e, M + n)."""
        estimates, size = self.gains.shape[1], self.size
        known = np.array(self.advance[:size])
        known[:estimates] += self.gains[-1] @ self.advance[size:]
        observation = np.eye(self.observation_size, size + self.observation_size, size)
        return np.vstack([known, self.show @ np.vstack([known, observation])])

    @cached_property
    def _reduced(self) -> tuple[NDArray[np.intp], FloatArray]:
        """Entries of an observation that `advance` reads, and its rows (M + s, M + their number)."""
        used = np.flatnonzero(self.advance[:, self.size :].any(axis=0))
        columns = np.concatenate([np.arange(self.size), self.size + used])
        return used, np.ascontiguousarray(self.advance[:, columns])

    def _weigh_early(
        self, memory: FloatArray, observation: FloatArray, age: NDArray[np.int_]
    ) -> tuple[FloatArray, FloatArray]:
        """Weigh the readings in numpy, as `_weigh` does and to the same bits, at ages below the last."""
        estimates, size = self.gains.shape[1], self.size
        used, rows = self._reduced
        both = np.concatenate([memory, observation[..., used]], axis=-1) @ rows.T
        fresh = age == 0
        if fresh.any():
            both[fresh] *= self.begins
        known = np.empty((*both.shape[:-1], size + observation.shape[-1]))
        known[..., :size], known[..., size:] = both[..., :size], observation
        gains = self.gains[age]
        known[..., :estimates] += (gains @ both[..., size:, None])[..., 0]
        return known[..., :size], known @ self.show.T

    def _weigh(self, memory: Array, observation: Array, age: Any) -> tuple[Array, Array]:
        """Weigh the readings at any age, which a gradient goes through."""
        xp = array_api_compat.array_namespace(observation)
        estimates, size = self.gains.shape[1], self.size
        both = xp.concat([memory, observation], axis=-1) @ self.advance.T
        if np.any(age == 0):
            fresh = as_like(np.asarray(age == 0, dtype=float), both)[..., None]
            both = both * (1.0 - fresh * (1.0 - self.begins))
        innovation = both[..., size:]
        last = len(self.gains) - 1
        if np.all(age >= last):
            change = innovation @ self.gains[last].T
        else:
            index = np.minimum(age, last)
            gains = self.gains[index if xp is array_api_compat.numpy else xp.asarray(index)]
            change = (gains @ innovation[..., None])[..., 0]
        known = xp.concat([both[..., :estimates] + change, both[..., estimates:size]], axis=-1)
        return known, xp.concat([known, observation], axis=-1) @ self.show.T

    def show_to(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None,
        episode_start: NDArray[np.bool_] | None,
    ) -> tuple[NDArray[np.int_], FloatArray, FloatArray]:
        """Weigh an observation (..., n) for a controller that keeps memory and age as its state.

        Returns
        -------
        Periods since the start (...), what the law knows, and what it shows (..., e). The next state is
        ``(keep(known, action), age + 1)``.
        """
        lead = observation.shape[:-1]
        age = np.zeros(lead, dtype=int) if state is None else state[1]
        past = np.zeros((*lead, self.size)) if state is None else state[0]
        if state is not None and episode_start is not None:
            begun = np.reshape(episode_start, lead)
            age, past = np.where(begun, 0, age), np.where(begun[..., None], 0.0, past)
        known, shown = self.look(past, observation.astype(float), age)
        return age, known, shown

    def keep(self, known: Array, action: Array) -> Array:
        """Return the memory (..., M) once an action (...) within [-1, 1] was given."""
        xp = array_api_compat.array_namespace(known)
        first = self.gains.shape[1]
        last = first + self.actions
        parts = [known[..., :first], known[..., first + 1 : last], action[..., None], known[..., last:]]
        return xp.concat(parts, axis=-1)


def _matrices(scenario: Scenario, controller: EstimatedState, row: FloatArray) -> EstimatedLaw:
    layout, observation = scenario.plant.layout, scenario.observation
    model, recursion = controller.estimator.model, controller.recursion
    full = scenario.sensing.full_state
    n, s, t, c = observation.size, len(model.C), model.order, model.commands + 1
    w, r = layout.filter_states, 2 * layout.stories
    table, actions = slice(0, t), slice(t, t + c)
    ground, reference = slice(t + c, t + c + w), slice(t + c + w, t + c + w + r)
    size = reference.stop
    look = np.eye(n)  # rows of entries of the observation
    advance = np.zeros((size + s, size + n))
    advance[actions, actions] = np.eye(c)
    if scenario.sensing.last_action:
        advance[actions.stop - 1, actions.stop - 1] = 0.0
        advance[actions.stop - 1, size:] = look[observation.last_action][0]
    advance[table] = model.B @ advance[actions]
    advance[table, table] += model.A
    advance[ground, size:] = look[layout.ground]
    if full:
        advance[reference, size:] = look[layout.reference]
    else:
        advance[reference, reference] = recursion.S
        advance[reference, ground] = recursion.W_before
        advance[reference, size:] = recursion.W_now @ look[layout.ground]
    begins = np.ones(size + s)
    begins[: ground.start] = 0.0
    begins[reference] = float(full)
    advance[size:] = -model.C @ advance[table]
    advance[size:, size:] += look[layout.controlled if full else observation.readings]
    # From [known, observation] to what a full-state law is shown.
    known = np.eye(size, size + n)
    preview = np.pad(look[observation.preview], ((0, 0), (size, 0)))
    exogenous = controller.predicted_ground @ np.vstack([known[ground], known[reference], preview])
    ahead = model.ahead @ np.vstack([known[table], known[actions][1:]])
    believed = np.vstack([exogenous[:w], ahead, exogenous[w:]])
    disturbances = known[len(ahead) : len(ahead) + 2]
    show = np.vstack([believed[: layout.order], disturbances, (row @ believed)[None]])
    return EstimatedLaw(advance, controller.estimator.gains, show, begins, c)
