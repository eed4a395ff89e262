"""A plan as a law that a policy is shown and may correct: its currents, and the signals that it expects.

The planner runs beside the tables: `nmpc` plans at every period on its own estimate, `planned` plays
recorded motions that were planned before. The environments, the wrappers and the controller of a
trained model all ask this one law.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from baselines.planning.nmpc import NonlinearPredictiveControl
from baselines.planning.planned import PlannedControl
from baselines.registry import make_baseline
from shake_env.controller import decide
from shake_env.errors import ParameterError, ScenarioError, unknown
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import EpisodeMotion, Motion, MotionSet, RecordedMotion
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario

Planner = Literal["nmpc", "planned"]
PLANNERS: tuple[Planner, ...] = ("nmpc", "planned")


@dataclass(frozen=True, kw_only=True)
class PlanOptions:
    """Which planner runs beside a table, what is shown of its plan, and whether it acts.

    Raises
    ------
    ParameterError
        If the planner is unknown, or the periods are not whole numbers that begin with 0 and increase.
    """

    planner: Planner = "nmpc"
    ahead: tuple[int, ...] = (0, 1, 2, 4, 8)  # periods shown, 0 the one that begins now
    corrected: bool = False  # whether actions are added to the plan's current

    def __post_init__(self) -> None:
        if self.planner not in PLANNERS:
            raise unknown(ParameterError, "planner", str(self.planner), PLANNERS)
        steps = np.asarray(self.ahead)
        whole = steps.ndim == 1 and steps.size > 0 and steps.dtype.kind == "i"
        if not whole or steps[0] != 0 or (np.diff(steps) <= 0).any():
            remedy = "must be whole control periods that begin with 0 and increase, such as (0, 1, 4)"
            raise ParameterError("ahead", self.ahead, remedy)
        object.__setattr__(self, "ahead", tuple(steps.tolist()))


class PlanLaw:
    """A planner of N tables whose memory is an array (N, M), and what is shown of its plan.

    Shown are e = 3 a entries of the a periods `ahead`: currents over the current limit, table
    accelerations over the unit target's rms and base shears over the specimen's mass times that, as
    readings are (`ObservationLayout.reading_scale`). A current is held over its period; signals are
    those expected at the period's end.

    Parameters
    ----------
    scenario
        What the tables show.
    planner
        `NonlinearPredictiveControl` or `PlannedControl` of that scenario.
    ahead, corrected
        As in `PlanOptions`.
    motions
        Those whose plans `planner` has, in order; empty: it needs none.

    Raises
    ------
    ParameterError
        If a period lies behind the planner's horizon.
    """

    def __init__(
        self,
        scenario: Scenario,
        planner: NonlinearPredictiveControl | PlannedControl,
        *,
        ahead: Sequence[int] = PlanOptions.ahead,
        corrected: bool = True,
        motions: Sequence[Motion] = (),
    ) -> None:
        self.scenario, self.planner, self.corrected = scenario, planner, corrected
        self.ahead, self.motions = tuple(ahead), tuple(motions)
        if isinstance(planner, NonlinearPredictiveControl) and max(ahead) >= planner.horizon:
            remedy = f"must lie below the {planner.horizon} control periods that nmpc plans"
            raise ParameterError("ahead", max(ahead), remedy)
        acceleration = float(np.sqrt(scenario.plant.target_variance))
        sizes = (scenario.current_limit, acceleration, scenario.specimen.mass * acceleration)
        self._sizes = np.repeat(sizes, len(self.ahead))

    @classmethod
    def from_options(
        cls,
        scenario: Scenario,
        options: PlanOptions,
        earthquakes: Sequence[Earthquake] | None = None,
    ) -> PlanLaw:
        """Return the law of a planner's name, as `make_baseline` designs it.

        Parameters
        ----------
        scenario
            What the tables show.
        options
            Planner, and what is shown.
        earthquakes
            Those that `planned` plans, one a lane of a roll-out; None: the scenario's own recorded
            motions, planned at once (half a second of processor time a second of motion).

        Raises
        ------
        ScenarioError
            If the planner does not suit the scenario, as with the equations as printed, or its motion is
            not known before the test.
        ShakeError
            If numba is missing.
        """
        motions: tuple[Motion, ...] = ()
        if options.planner == "nmpc":
            made = make_baseline("nmpc", scenario)
        else:
            known = _known_motions(scenario) if earthquakes is None else earthquakes
            motions = tuple(quake.motion for quake in known)
            made = make_baseline("planned", scenario, earthquakes=known)
        assert isinstance(made, NonlinearPredictiveControl | PlannedControl)
        return cls(scenario, made, ahead=options.ahead, corrected=options.corrected, motions=motions)

    @property
    def shown(self) -> int:
        """Number e of entries that it shows."""
        return len(self._sizes)

    @cached_property
    def size(self) -> int:
        """Length M of a table's memory."""
        last: int = self._parts[-1][0].stop
        return last

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Name of each entry with its unit, in order."""
        signals = {"current": "-", "table acceleration": "m/s^2", "base shear": "N"}
        return tuple(
            f"planned {signal} {period} periods ahead [{unit}]"
            for signal, unit in signals.items()
            for period in self.ahead
        )

    def rest(self, lanes: int) -> FloatArray:
        """Return the memory (N, M) of tables at rest.

        Raises
        ------
        ParameterError
            If plans were made for another number of tables.
        """
        memory = np.zeros((lanes, self.size))
        if isinstance(self.planner, PlannedControl):
            memory[:, self._columns["row"]] = self.planner.rows(lanes)
        return memory

    def begin(self, motions: Sequence[EpisodeMotion]) -> FloatArray:
        """Return the memory (N, M) of tables at rest, each at the start of its motion.

        Raises
        ------
        ScenarioError
            If a motion has no plan.
        """
        memory = np.zeros((len(motions), self.size))
        if not isinstance(self.planner, PlannedControl):
            return memory
        for lane, motion in enumerate(motions):
            if motion not in self.motions:
                remedy = "has no plan: give a scenario whose motions are recorded, or take nmpc"
                raise ScenarioError("motion", motion, remedy)
            memory[lane, self._columns["row"]] = self.motions.index(motion)
        return memory

    def look(
        self, memory: FloatArray, observation: NDArray[np.floating[Any]], age: NDArray[np.int_]
    ) -> tuple[FloatArray, NDArray[np.float32]]:
        """Plan from an observation.

        Parameters
        ----------
        memory
            (N, M) what :meth:`keep` returned; at an episode's start `rest` or `begin`.
        observation
            (N, n)
        age
            (N,) periods since the start of the episode.

        Returns
        -------
        known, shown
            (N, M) for :meth:`keep`, and (N, e); the first entry is the planner's own action.
        """
        action, state = decide(self.planner, observation, (self._unpack(memory),), age == 0)
        assert state is not None
        expected: Any = self.planner.expected(state[0], self.ahead)
        shown = (np.concatenate(expected, axis=1) / self._sizes).astype(np.float32)
        shown[:, :1] = action
        return _pack(state[0]), shown

    def keep(self, known: FloatArray, action: NDArray[np.floating[Any]]) -> FloatArray:
        """Return the memory (N, M) once actions (N,) within [-1, 1] were given.

        The planner's own action leaves it to the bit as it is.
        """
        limit, place = self.scenario.current_limit, self._columns["current"]
        given, memory, current = np.reshape(action, -1), known.copy(), known[:, place]
        own = (current / limit).astype(np.float32) == given
        memory[:, place] = np.where(own, current, given * limit)
        return memory

    def show_to(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None,
        episode_start: NDArray[np.bool_] | None,
    ) -> tuple[Any, FloatArray, NDArray[np.float32]]:
        """Plan from an observation (..., n) for a controller that keeps memory and age as its state.

        Returns
        -------
        Periods since the start (...), what the law knows (N, M), and what it shows (..., e). The next
        state is ``(keep(known, action), age + 1)``.
        """
        lead = observation.shape[:-1]
        rows = observation.reshape(-1, observation.shape[-1])
        age = np.zeros(lead, dtype=int) if state is None else state[1]
        if state is not None and episode_start is not None:
            age = np.where(np.reshape(episode_start, lead), 0, age)
        memory = self.rest(len(rows)) if state is None else state[0]
        known, shown = self.look(memory, rows, age.reshape(-1))
        return age, known, shown.reshape(*lead, -1)

    @cached_property
    def _template(self) -> Any:
        """What the planner remembers, for the sizes and types of its parts."""
        lanes = max(len(self.motions), 1)
        shown = np.zeros((lanes, self.scenario.observation.size), dtype=np.float32)
        state = self.planner.predict(shown)[1]
        assert state is not None
        return state[0]

    @cached_property
    def _columns(self) -> dict[str, int]:
        """Where in a row of the memory each of the planner's own parts begins."""
        columns, first = {}, 0
        for field in fields(self._template):
            columns[field.name] = first
            first += sum(leaf[0].size for leaf in _leaves(getattr(self._template, field.name)))
        return columns

    @cached_property
    def _parts(self) -> list[tuple[slice, tuple[int, ...], Any]]:
        """Columns, shape a table and type of each array of the planner's memory, in order."""
        parts, first = [], 0
        for leaf in _leaves(self._template):
            parts.append((slice(first, first + leaf[0].size), leaf.shape[1:], leaf.dtype))
            first += leaf[0].size
        return parts

    def _unpack(self, memory: FloatArray) -> Any:
        """Return the planner's own memory of an array (N, M)."""
        lanes = len(memory)
        arrays = (
            np.ascontiguousarray(memory[:, columns].reshape(lanes, *shape), dtype=kind)
            for columns, shape, kind in self._parts
        )
        return _rebuilt(self._template, arrays)


def _known_motions(scenario: Scenario) -> list[Earthquake]:
    """Return the recorded motions that an episode of the scenario can draw."""
    motion = scenario.motion
    motions = motion.scaled if isinstance(motion, MotionSet) else (motion,)
    known = [Earthquake(m.source.name, m) for m in motions if isinstance(m, RecordedMotion)]
    if len(known) < len(motions):
        remedy = "is drawn at each reset: planned needs recorded motions (record=NAME), or take nmpc"
        raise ScenarioError("motion", "filtered noise", remedy)
    return known


def _leaves(memory: Any) -> Iterator[NDArray[Any]]:
    """Yield the arrays of a memory, in order."""
    if is_dataclass(memory):
        for field in fields(memory):
            yield from _leaves(getattr(memory, field.name))
    elif memory is not None:
        yield memory


def _rebuilt(template: Any, parts: Iterator[NDArray[Any]]) -> Any:
    """Return a memory of other arrays than the template's."""
    if is_dataclass(template) and not isinstance(template, type):
        names = [field.name for field in fields(template)]
        return replace(template, **{name: _rebuilt(getattr(template, name), parts) for name in names})
    return None if template is None else next(parts)


def _pack(memory: Any) -> FloatArray:
    """Return a memory as one array (N, M)."""
    rows = [leaf.reshape(len(leaf), -1) for leaf in _leaves(memory)]
    return np.concatenate(rows, axis=1, dtype=float)
