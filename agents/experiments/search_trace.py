"""The trace of an experiment's search as a file, and as what a page shows of it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from agents.experiments.search_space import Choice, Knob, Value, search_space_json, search_space_of
from agents.reporting.markdown_blocks import markdown_table, put_block
from agents.run_directory import read_json
from shake_env.errors import ParameterError
from shake_env.files import write_text

FORMAT = "shake-recipe-search-1"
PREFIX = "training_search_"  # of a trace's file name in docs/results
BEST = 4  # the best of so many trials that were judged are what the table calls the best quarter


@dataclass(frozen=True, kw_only=True)
class TrialRow:
    """One trial: what was drawn and what came of it."""

    number: int
    state: str  # complete, pruned, failed
    values: dict[str, Value]
    cost: float | None  # [-] mean on the validation earthquakes over the reference's; None: not judged
    low: float | None = None  # [-] its 95 % interval over earthquakes
    high: float | None = None
    lost: int | None = None  # tables that met a limit there; their cost is in the mean
    ratio: float | None = None  # [-] best of the run's own evaluations
    seconds: float = 0.0  # processor time
    default: bool = False  # whether its values are the experiment's own
    code: str | None = None
    failure: str | None = None


@dataclass(frozen=True, kw_only=True)
class Trace:
    """Every trial of a search, with what decided it."""

    experiment: str  # SCENARIO/ALGORITHM
    share: float  # of the experiment's steps that a trial trains for
    steps: int
    seed: int  # of the search
    train_seed: int  # of every trial's training
    earthquakes: int
    validation_seed: int  # of the first of them
    reference: str
    reference_lost: int  # tables that the reference loses on them
    version: str
    machine: str
    space: tuple[Knob, ...]
    own: dict[str, Value]  # the experiment's values
    trials: tuple[TrialRow, ...]

    @property
    def judged(self) -> list[TrialRow]:
        """The trials that have a cost, the best first."""
        return sorted((t for t in self.trials if t.cost is not None), key=_cost)

    @property
    def best(self) -> TrialRow | None:
        """The best of them."""
        return next(iter(self.judged), None)

    @property
    def start(self) -> TrialRow | None:
        """The experiment as it stands, if it was judged."""
        return next((t for t in self.judged if t.default), None)

    def to_json(self) -> dict[str, Any]:
        """Return the trace as plain JSON values."""
        states = [t.state for t in self.trials]
        counts = {state: states.count(state) for state in sorted(set(states))}
        seconds = round(sum(t.seconds for t in self.trials), 1)
        plain = {**asdict(self), "space": search_space_json(self.space)}
        plain["trials"] = [asdict(t) for t in self.trials]
        return {"format": FORMAT, "budget": {**counts, "processor_seconds": seconds}, **plain}


def _cost(row: TrialRow) -> float:
    return math.inf if row.cost is None else row.cost


def write_trace(trace: Trace, file: str | PathLike[str]) -> None:
    """Write the trace of a training search, a trial on each line; a reader never sees half of it.

    Raises
    ------
    ParameterError
        If no trial is done, or the file's name is not that of a JSON file.
    """
    file = Path(file)
    if not trace.trials:
        raise ParameterError("trials", 0, f"none is done of {trace.experiment}: nothing to keep")
    if file.suffix != ".json":
        raise ParameterError("output", str(file), f"must be a file such as {PREFIX}linear_ppo.json")
    plain = trace.to_json()
    trials = ",\n".join(f"  {json.dumps(row)}" for row in plain.pop("trials"))
    text = f'{json.dumps(plain, indent=1)[:-2]},\n "trials": [\n{trials}\n ]\n}}\n'
    write_text(file, text)


def read_trace(file: str | PathLike[str]) -> Trace:
    """Return the trace of a training search that a file holds.

    Raises
    ------
    ParameterError
        If it holds none.
    """
    file = Path(file)
    try:
        values = read_json(file)
        if values.pop("format") != FORMAT:
            raise KeyError("format")
        values.pop("budget")
        rows = tuple(TrialRow(**row) for row in values.pop("trials"))
        return Trace(**{**values, "space": search_space_of(values["space"]), "trials": rows})
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        remedy = f"holds no trace of an experiment's search ({error}): make it anew with --keep"
        raise ParameterError("trace", str(file), remedy) from error


def read_traces(folder: str | PathLike[str]) -> list[Trace]:
    """Return the search traces of a folder, in the order of their files' names."""
    folder = Path(folder)
    return [read_trace(file) for file in sorted(folder.glob(f"{PREFIX}*.json"))]


def trace_file_name(experiment: str) -> str:
    """Return the name, without ending, of the files of an experiment's search: trace and figure."""
    return PREFIX + experiment.replace("/", "_")


def search_markdown(trace: Trace, figures: str) -> str:
    """Return a training search as a section of a page: costs, best values, a table, the figure.

    Parameters
    ----------
    trace
        What is shown.
    figures
        Folder of the figure, as a page names it.
    """
    states = [t.state for t in trace.trials]
    counts = ", ".join(f"{states.count(state)} {state}" for state in sorted(set(states)))
    hours = sum(t.seconds for t in trace.trials) / 3600.0
    codes = ", ".join(sorted({t.code for t in trace.trials if t.code})) or "no git checkout"
    lines = [
        f"### {trace.experiment}",
        "",
        f"{len(trace.trials)} trials ({counts}) of {trace.steps:,} steps each, {trace.share:g} of the "
        f"experiment's; {hours:.1f} hours of processor time. Search seed {trace.seed}, training seed "
        f"{trace.train_seed}; {trace.earthquakes} validation earthquakes from seed "
        f"{trace.validation_seed}, costs relative to `{trace.reference}`, which loses "
        f"{trace.reference_lost} tables. Version {trace.version} ({codes}), {trace.machine}.",
        "",
    ]
    judged = trace.judged
    if not judged:
        return "\n".join([*lines, "No trial came to be judged.", ""])
    best, start = judged[0], trace.start
    good = judged[: max(1, len(judged) // BEST)]
    head = (
        "value",
        "searched",
        "experiment",
        f"best trial ({best.number})",
        f"best quarter ({len(good)})",
    )
    lost = ["-" if start is None else str(start.lost), str(best.lost)]
    rows: list[tuple[str, ...]] = [
        ("cost [95 %]", "", _judged(start), _judged(best), f"to {_number(_cost(good[-1]))}"),
        ("tables lost", "", *lost, _span([t.lost or 0 for t in good])),
    ]
    for knob in trace.space:
        drawn = [t.values[knob.name] for t in good]
        span = _chosen(knob, drawn) if isinstance(knob, Choice) else _span(drawn)
        values = (trace.own[knob.name], best.values[knob.name])
        rows.append((knob.meaning, _searched(knob), *map(_number, values), span))
    figure = f"{figures}/{trace_file_name(trace.experiment)}.png"
    caption = f"Cost of each trial of {trace.experiment} over each value that was searched"
    return "\n".join([*lines, markdown_table(head, rows), f"![{caption}]({figure})", ""])


def _judged(row: TrialRow | None) -> str:
    if row is None:
        return "-"
    return f"{_number(_cost(row))} [{_number(row.low)}, {_number(row.high)}]"


def _number(value: Value | None) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return "-" if value is None else str(value)


def _span(values: Sequence[Value]) -> str:
    low, high = min(values), max(values)
    return _number(low) if low == high else f"{_number(low)} to {_number(high)}"


def _searched(knob: Knob) -> str:
    if isinstance(knob, Choice):
        return ", ".join(map(_number, knob.values))
    return f"{knob.low:g} to {knob.high:g}" + (", logarithmic" if knob.logarithmic else "")


def _chosen(knob: Choice, drawn: Sequence[Value]) -> str:
    return ", ".join(f"{_number(v)} ({drawn.count(v)})" for v in knob.values if v in drawn)


def put_searches(page: str | PathLike[str], traces: Sequence[Trace], figures: str = "figures") -> None:
    """Put all searches into a page, at ``<!-- training searches -->`` (`markdown_blocks.put_block`)."""
    page = Path(page)
    put_block(page, "training searches", "\n".join(search_markdown(trace, figures) for trace in traces))
