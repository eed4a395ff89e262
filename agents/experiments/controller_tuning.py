"""Search a classical controller's free parameters on validation earthquakes, within a stated budget.

The first trial is the default. A search that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

import shake_env
from agents.execution.executor import Executor
from agents.execution.units import Unit, UnitRunner, report
from agents.execution.worker import Call
from agents.experiments.parameter_search import search_parameters
from agents.experiments.study_storage import is_shared, storage_errors
from agents.policies.own_controller import is_own_controller, own_baseline, own_source
from agents.run_directory import locked_folder
from agents.seeds import VALIDATION_SEED
from baselines.baseline import Baseline
from baselines.registry import baseline_of, parameter_values
from baselines.searched_lqg import LQG_SEARCHED, LQG_SEARCHED_FORCE, searched_baseline, searched_values
from baselines.tuned_values import TunedEntry, TunedValues, read_tuned, write_tuned
from shake_env.controller import Controller
from shake_env.errors import (
    NumericalError,
    ParameterError,
    ScenarioError,
)
from shake_env.motion.targets import FilteredNoise
from shake_env.renamed import CONTROLLERS, renamed
from shake_env.rollout import Earthquake, noise_earthquakes, rollout
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.scenario import Scenario

FAILED = 1e6  # cost of a trial whose design fails


@dataclass(frozen=True)
class TuningResult:
    """What a search came to."""

    controller: str
    scenario: str  # its name, for a reader
    digest: str  # what the values belong to, see `shake_env.scenario.digest`
    parameters: dict[str, float]
    cost: float  # mean stage cost on the validation earthquakes
    default_cost: float
    trials: int
    table_steps: int  # control periods of all tables in all trials
    earthquakes: int
    seed: int

    def to_json(self) -> dict[str, Any]:
        """Return the result as plain JSON values, with the version that made it."""
        return {"version": shake_env.__version__, **vars(self)}


def tune(
    name: str,
    scenario: Scenario,
    storage: str | PathLike[str],
    *,
    budget: int = 4_000_000,
    earthquakes: int = 16,
    seed: int = 0,
    tuned: TunedValues | None = None,
    on_trial: Callable[[int, int, float], None] = lambda done, total, best: None,
    executor: Executor | None = None,
) -> TuningResult:
    """Search a controller's parameters for the least cost, or go on with that search.

    Parameters
    ----------
    name
        Of `baselines.registry.CLASSICAL`, or a controller of one's own.
    scenario
        Its motion is that of the validation earthquakes.
    storage
        SQLite file that keeps the trace of every search, made if need be; or the URL of a storage that
        several processes work on at a time, see `study_storage`.
    budget
        Control periods that may be simulated in all, repeats included: what a policy is trained with by
        default.
    earthquakes
        Validation earthquakes of a trial.
    seed
        Of the search.
    tuned
        Values that were found before; the search of the free design begins at them, too.
    on_trial
        Told the trials done, those in all, and the best cost, after each.
    executor
        Its workers simulate the trials, see `search_parameters`; None: this process.

    Raises
    ------
    ScenarioError
        If the controller is unknown or does not suit the scenario.
    ParameterError
        If it has nothing to tune, or the budget is below one trial.
    """
    name = renamed("controller", name, CONTROLLERS)
    candidate = tunable_baseline(name, scenario)
    tunable = candidate.tunable
    if not tunable:
        raise ParameterError("controller", name, "has no free parameter: its design decides everything")
    motions = noise_earthquakes(scenario, earthquakes, VALIDATION_SEED)
    noise = motions[0].motion
    assert isinstance(noise, FilteredNoise)
    steps = round(noise.duration / scenario.control_period) * earthquakes
    steps *= candidate.tests
    total = trials_of(budget, steps)
    starts = [{each: t.default for each, t in tunable.items()}, *starting_points(name, scenario, tuned)]
    if not candidate.takes_earthquakes:
        candidate.make(scenario, **starts[0])  # says at once if the scenario does not suit it

    def cost(values: dict[str, float]) -> float:
        return _cost_of(candidate, scenario, motions, values)

    def call(number: int, values: dict[str, float]) -> Call:
        return Call(f"{name}, trial {number}", _cost_of, (candidate, scenario, motions, values))

    # Another scenario of that name, or other ranges, are another search.
    parts = (scenario, tunable, own_source(name)) if is_own_controller(name) else (scenario, tunable)
    identity = zlib.crc32(repr(parts).encode())
    study = f"{scenario.name}/{name}/{seed}/{earthquakes}/{identity:08x}"
    with ExitStack() as held:
        if not is_shared(storage):
            # Two processes would both try the starts, and draw the same trials.
            file = Path(storage)
            home = file.with_name(f"{file.stem}-locks") / re.sub(r"[^\w.-]+", "_", study)
            held.enter_context(locked_folder(home, field="study"))
        held.enter_context(storage_errors(storage))
        result = search_parameters(
            cost, tunable, storage, study, total, seed, on_trial, starts, executor, call
        )
    return TuningResult(
        name, scenario.name, scenario_digest(scenario), result.parameters, result.cost,
        result.default_cost, result.trials, result.trials * steps, earthquakes, seed,
    )  # fmt: skip


def tune_each(
    names: Sequence[str],
    scenario: Scenario,
    storage: str | PathLike[str],
    *,
    budget: int,
    earthquakes: int,
    seed: int,
    tuned: TunedValues | None,
    runner: UnitRunner,
    on_progress: Callable[[str, float], None],
) -> dict[str, TuningResult | str]:
    """Tune several controllers, each a unit; see `tune`.

    In an SQLite file workers have a study each, and wait for one another when they write.

    Returns
    -------
    A result for each, or why the controller was left out.

    Raises
    ------
    ParameterError
        If the storage is a file and workers may be on other machines, or it cannot be used.
    """
    options = (str(storage), budget, earthquakes, seed)
    if not is_shared(storage) and not runner.on_this_machine:
        remedy = (
            "is a file of this machine, and workers may be on others: give a URL, such as "
            "journal:FILE on a file system that they share"
        )
        raise ParameterError("storage", str(storage), remedy)
    units = [Unit(name, _tuned, (name, scenario, tuned, *options)) for name in names]
    tunings = runner.run(units, lambda index, share: on_progress(names[index], share))
    return {
        name: each if isinstance(each, str) else TuningResult(**each)
        for name, each in zip(names, tunings, strict=True)
    }


def _tuned(
    name: str,
    scenario: Scenario,
    tuned: TunedValues | None,
    storage: str,
    budget: int,
    earthquakes: int,
    seed: int,
) -> dict[str, Any] | str:
    def on_trial(done: int, total: int, best: float) -> None:
        report(done / total)

    try:
        result = tune(
            name, scenario, storage, budget=budget, earthquakes=earthquakes, seed=seed, tuned=tuned,
            on_trial=on_trial,
        )  # fmt: skip
    except (ParameterError, ScenarioError, NumericalError) as error:
        if error.field == "storage":  # which no other controller could use either
            raise
        return str(error)
    return vars(result)


def _cost_of(
    candidate: Baseline,
    scenario: Scenario,
    motions: Sequence[Earthquake],
    values: dict[str, float],
) -> float:
    quakes = [motions] if candidate.takes_earthquakes else []
    return mean_cost(lambda: candidate.make(scenario, *quakes, **values), scenario, motions)


def tunable_baseline(name: str, scenario: Scenario) -> Baseline:
    """Return the controller called `name`, a classical one or one's own.

    Raises
    ------
    ScenarioError
        If there is none of that name, or it takes the values of another.
    """
    if is_own_controller(name):
        return own_baseline(name)
    if name == LQG_SEARCHED_FORCE:
        raise ScenarioError("controller", name, f"takes the values of {LQG_SEARCHED}: tune that")
    return baseline_of(name, scenario)


def starting_points(
    name: str, scenario: Scenario, tuned: TunedValues | None = None
) -> list[dict[str, float]]:
    """Return what is tried after the defaults: for the free design what others were tuned to.

    Values outside what is searched are left out.
    """
    if name != LQG_SEARCHED:
        return []
    points = []
    tuned = None if tuned is None else tuned.of_scenario(scenario_digest(scenario))
    for other in ("preview-lqr", "lqg", "lqg-dac"):
        values = parameter_values(other, scenario, tuned)
        if values.source != "rule":
            accommodates = other == "lqg-dac"
            points.append(searched_values(scenario, values.parameters, accommodates=accommodates))
    free = searched_baseline(scenario).tunable
    return [p for p in points if all(free[n].low <= value <= free[n].high for n, value in p.items())]


def trials_of(budget: int, steps: int) -> int:
    """Return how many tuning trials of `steps` control periods a budget pays for.

    Raises
    ------
    ParameterError
        If it pays for none.
    """
    if budget < steps:
        raise ParameterError("budget", budget, f"one trial takes {steps} control periods")
    return budget // steps


def mean_cost(
    make: Callable[[], Controller], scenario: Scenario, earthquakes: Sequence[Earthquake]
) -> float:
    """Return the mean stage cost of what `make` designs; `FAILED` where there is no such design."""
    try:
        rows, _ = rollout(make(), scenario, earthquakes)
    except NumericalError:
        return FAILED
    mean = float(np.mean([row.cost for row in rows]))
    return mean if math.isfinite(mean) else FAILED


def keep_tuned_values(tuning: TuningResult, file: str | PathLike[str]) -> None:
    """Put a search's result into a file of tuned values, in place of that of the same search.

    Raises
    ------
    ParameterError
        If the file is there and is no file of tuned values.
    """
    file = Path(file)
    known = kept_values(file) or TunedValues(str(file))
    search = tuning.to_json()
    entry = TunedEntry(
        controller=search.pop("controller"),
        digest=search.pop("digest"),
        scenario=search.pop("scenario"),
        parameters=search.pop("parameters"),
        search=search,
    )
    write_tuned(known.with_entry(entry), file)


def kept_values(file: Path | None) -> TunedValues | None:
    """Return the tuned values that a file of results holds; None where there is no such file yet."""
    return read_tuned(file) if file is not None and file.exists() else None
