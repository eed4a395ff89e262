"""Results of a campaign: every task's policies and baselines under the protocol, row by row."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import Any

from agents.evaluation.bound_store import search_code
from agents.evaluation.entries import Entry, find_entry
from agents.evaluation.protocol import can_supervise, evaluate
from agents.evaluation.result_files import PREFIX, read_result, write_result
from agents.execution.units import UnitRunner
from agents.experiments.evaluation_tasks import EvaluationTask
from agents.run_directory import POLICY
from agents.seeds import TEST_SEED
from baselines.registry import tuned_parameters
from shake_env.errors import ParameterError
from shake_env.scenario.scenario import Scenario


def policy_folders(task: EvaluationTask, folder: str | PathLike[str]) -> list[Path]:
    """Return the folders of runs, one an algorithm, whose policies an evaluation task takes."""
    folder = Path(folder)
    own = folder / (task.trained_on or task.name)
    return sorted({file.parents[1] for file in own.glob(f"*/*/{POLICY}")})


def evaluate_task(
    task: EvaluationTask,
    folder: str | PathLike[str],
    results: str | PathLike[str],
    *,
    again: bool = False,
    runner: UnitRunner | None = None,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> tuple[Path, dict[str, Any], bool]:
    """Return the file of an evaluation task's result, the result, and whether any of it was made now.

    A row holds while there is no policy for it that it was not made of, and a rival's while it is in the
    file, tuned as it is now: a row whose policies lie on no disk here any more stays. What does not hold
    is run, and with it the reference and the uncontrolled table, whose costs must match the stored ones.
    Bounds are computed anew where the code that searches them is another. No other code's version is
    compared: most of its changes affect no figure. `again` evaluates all rows, of the policies that
    there are; `runner` runs the parts of the evaluation (None: this process).

    Raises
    ------
    ParameterError
        If rows are to stay, but the costs of the uncontrolled table differ from the stored ones;
        or if a row of some policies would become one of fewer others.
    """
    folder, results = Path(folder), Path(results)
    file = results / f"{PREFIX}{task.name}.json"
    scenario = task.options.build()
    rows = [find_entry(str(runs), scenario) for runs in policy_folders(task, folder)]
    rows += [Entry(name) for name in task.baselines]
    known = None
    if file.exists() and not again:
        known = _read(file, task)
    missing = [row for row in rows if known is None or not _holds(row, known, scenario)]
    if known is not None and not missing and known["bound"]["code"] == search_code():
        return file, known, False
    result = evaluate(
        scenario,
        missing,
        earthquakes=task.earthquakes,
        repeats=task.fidelity,
        known=known,
        runner=runner,
        on_progress=on_progress,
    )
    result |= {"evaluation_task": task.name, "identity": _identity(result, task)}
    write_result(result, file)
    return file, result, True


def _read(file: Path, task: EvaluationTask) -> dict[str, Any]:
    known = read_result(file)
    identity: Any = known.get("identity")
    complete = isinstance(identity, dict) and {"evaluation_task", "rows", "tuned"} <= set(identity)
    complete = complete and "bound" in known
    if not complete or identity["evaluation_task"] != _asked(task):
        raise ParameterError(
            "results",
            str(file),
            f"is no result of {task.name} as it is asked for now: move it away, or evaluate all rows "
            "anew (--rerun), of the policies that there are",
        )
    return known


def _holds(row: Entry, result: dict[str, Any], scenario: Scenario) -> bool:
    """Return whether a known row is this one's: the same rival, or policies that it was made of.

    A row of all its policies also has the figures within the safety supervisor over the bounds as they
    are now, where the supervisor applies.

    Raises
    ------
    ParameterError
        If others have come, some of the known ones are gone, and there are fewer than there were.
    """
    known = result["identity"]
    if row.name not in known["rows"]:
        return False
    if not row.policies:
        tuned: bool = known["tuned"].get(row.name, {}) == tuned_parameters(row.name, scenario)
        return tuned
    here = Counter(source["sha256"] for source in row.sources)
    there = Counter(known["rows"][row.name])
    if here == there:
        figures = next(each for each in result["rows"] if each["controller"] == row.name)
        current = "supervised" in figures and result["bound"]["code"] == search_code()
        return current or not can_supervise(scenario)
    if here <= there:
        return True
    if there <= here or here.total() >= there.total():
        return False
    raise ParameterError(
        "policies",
        row.name,
        f"{here.total()} in the folder, not all of them among the {there.total()} of the stored row, "
        "which they would replace: train as many seeds, move them away, or evaluate all rows (--rerun)",
    )


def _asked(task: EvaluationTask) -> dict[str, Any]:
    """Return what a result depends on but for its rows and the code."""
    asked: dict[str, Any] = json.loads(json.dumps(asdict(task.options)))
    return asked | {
        "earthquakes": task.earthquakes,
        "fidelity": task.fidelity,
        "seed": TEST_SEED,
    }


def _identity(result: dict[str, Any], task: EvaluationTask) -> dict[str, Any]:
    rows = {row["controller"]: [s["sha256"] for s in row["sources"]] for row in result["rows"]}
    scenario = task.options.build()
    tuned = {name: tuned_parameters(name, scenario) for name in rows if not rows[name]}
    return {
        "evaluation_task": _asked(task),
        "rows": rows,
        "tuned": tuned,
    }
