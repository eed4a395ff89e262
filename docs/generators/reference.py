"""The reference pages: scenarios, tables by name, controllers, columns, command line."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

from agents.cli.command_options import FolderOptions
from agents.cli.commands import COMMANDS
from agents.evaluation.results import COLUMNS
from agents.execution.options import ExecutionOptions
from baselines.catalogue import BASELINES
from baselines.information import MEANINGS
from baselines.registry import reference_name, tuned_parameters
from generators import NOTE
from generators.markdown import shown, table
from shake_env import SCENARIO_NAMES, make_scenario
from shake_env.errors import ShakeError
from shake_env.model.ranges import RANGES
from shake_env.scenario.field_table import MISSING, fields_of
from shake_env.scenario.forms import FORMS
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import flattened
from shake_env.scenario.tables import TABLE_NAMES, named_table

DESIGNABLE = ("linear", "as-printed", "laboratory", "unknown-specimen", "yielding")
SECTIONS = {"Specimen": "specimen", "RecordedMotion": "motion", "Uncertainty": "uncertainty"}
FORMS_NOTE = (
    "A scenario file gives a specimen, a motion or an uncertainty by the fields above, or by one of "
    "these forms, as a table `[specimen.uniform]` or `[motion.file]`.\n"
)
RANGES_NOTE = (
    "What each number may be, checked when its part is made; an error names field, value and "
    "range. A physics step that is too long for the fastest mode, and a scenario that needs more memory "
    "than four fifths of what is free, are refused too.\n"
)
TABLES_INTRODUCTION = """\
`shake compare --table NAME`, or `make_scenario("laboratory", {"table": "NAME"})`, exchanges the
table of a scenario. Actuator, input and its unit, control rate, physics step and the weight of the
input are the new table's, and the specimen keeps its mass ratio. In a scenario with limits, these,
stops, friction, valve, delay, sensors and the amplitude of the motion follow from the table's
facts: the filtered noise has the largest amplitude whose peaks (4.6 times the rms) stay within
stroke, velocity and force, and a record is scaled to them.

A number has either a source, named below it, or the reason why it is assumed. The policies that
ship were trained for `gavin-hoagg-2009`; another table refuses them.
"""
TABLES_LEFT_OUT = """\
## Not here: the 2020 benchmark of real-time hybrid simulation

The transfer system of Silva et al. is one actuator on an experimental frame. Its equations are
those of the actuator here: a second-order valve (`nonlinearity.valve.natural_frequency` and
`damping_ratio` from b1 and b2), a leaking oil column (a3), the piston's flow (a2, the oil
stiffness) and the product a1 b0 of the gains. What it is not is a shake table: no platen carries a
specimen whose base it accelerates, the frame's mass and stiffness are part of the tested structure,
and its objective is to follow a displacement with a known delay. Base shear, target acceleration
and limits of this project would have to be invented for it, so it has no name here.
"""


def comment(scenario: Scenario, path: str) -> str:
    """Return unit and meaning of a field, as its dataclass documents it."""
    *owners, name = path.split(".")
    part: Any = scenario
    for owner in owners:
        if isinstance(part, tuple):
            part = next(sensor for sensor in part if sensor.signal == owner)
            continue
        attribute, _, place = owner.rstrip("]").partition("[")
        part = getattr(part, attribute)
        if place and isinstance(part, tuple):
            part = part[int(place)]
    return next((about.meaning for about in fields_of(type(part)) if about.name == name), "")


def scenarios() -> str:
    """Return the page of every scenario, field by field."""
    every = {name: dict(flattened(make_scenario(name))) for name in SCENARIO_NAMES}
    usual, linear = every["linear"], make_scenario("linear")
    rows = [
        (f"`{path}`", shown(value), comment(linear, path))
        for path, value in usual.items()
        if path != "name"
    ]
    parts = [
        "# Scenarios, field by field\n",
        NOTE,
        "Every field of a scenario has a path, which `fields={...}` takes in Python and `--set` on the "
        "command line, and which a [scenario file](../howto/files.md) writes as `[a.b]` and `c`. "
        "`shake show-scenario NAME` prints the same.\n",
        "## linear\n",
        "The scenario that others are described against.\n",
        table(("field", "value", "unit, meaning"), rows),
    ]
    for name in SCENARIO_NAMES[1:]:
        scenario, values = make_scenario(name), every[name]
        rows = [
            (f"`{path}`", shown(value), shown(usual.get(path, "-")), comment(scenario, path))
            for path, value in values.items()
            if path != "name" and usual.get(path) != value
        ]
        layout = scenario.observation
        parts += [
            f"## {name}\n",
            f"[What is in it, and why](../scenarios/{name}.md). An observation has {layout.size} "
            f"entries, at {scenario.control_rate:g} Hz. "
            f"Costs are relative to `{reference_name(scenario)}`.\n",
            table(("field", "value", "in linear", "unit, meaning"), rows),
        ]
    parts += ["## Forms in files\n", FORMS_NOTE]
    for kind, forms in FORMS.items():
        for form, make in forms.items():
            rows = [
                (f"`{about.name}`", "needed" if about.default is MISSING else shown(about.default),
                 about.meaning)
                for about in fields_of(make)
            ]  # fmt: skip
            parts += [
                f"### {SECTIONS[kind.__name__]}.{form}\n",
                table(("field", "unset", "meaning"), rows),
            ]
    parts += ["## Ranges\n", RANGES_NOTE, ranges()]
    return "\n".join(parts)


def ranges() -> str:
    """Return the table of every parameter's range."""
    rows = [
        (f"`{kind}.{field}`", allowed.interval)
        for kind, fields_of in RANGES.items()
        for field, allowed in fields_of.items()
    ]
    return table(("parameter", "range"), rows)


def tables() -> str:
    """Return the page of tables by name: every number with its source or the reason it is assumed."""
    lines = ["# Tables by name", "", NOTE, TABLES_INTRODUCTION]
    for name in TABLE_NAMES:
        one = named_table(name)
        lines += [
            f"## {name}",
            "",
            f"{one.title[:1].upper()}{one.title[1:]}; input in {one.input_unit}.",
            "",
        ]
        lines += [f"- *{key}*: {text}." for key, text in one.references.items()]
        facts = [
            (
                f"`{key}`",
                f"{fact.value:.6g} {fact.unit}",
                f"*{fact.source}*" if fact.source else "assumed",
                fact.assumption or fact.note,
            )
            for key, fact in one.facts.items()
        ]
        published = [
            (f"`{key}`", f"{each.value:.6g} {each.unit}", f"*{each.source}*", each.note)
            for key, each in one.published.items()
        ]
        lines += ["", table(("fact", "value", "source", "reason or note"), facts), ""]
        lines += ["Published figures that follow from these:", ""]
        lines += [table(("figure", "value", "source", "note"), published), ""]
    return "\n".join([*lines, TABLES_LEFT_OUT])


def suits(name: str, scenario: Scenario) -> bool:
    """Return whether a controller can be designed for a scenario."""
    baseline = BASELINES[name]
    try:
        if baseline.check is not None:
            baseline.check(scenario)
        if baseline.takes_earthquakes:
            return True
        baseline.make(scenario, **{each: t.default for each, t in baseline.tunable.items()})
    except ShakeError:
        return False
    return True


def controllers() -> str:
    """Return the page of every controller and its free parameters."""
    built = {name: make_scenario(name) for name in DESIGNABLE}
    rows, tuned = [], []
    for name, baseline in BASELINES.items():
        places = ", ".join(s for s, scenario in built.items() if suits(name, scenario))
        rows.append((f"`{name}`", baseline.summary, baseline.class_name, places))
        for each, t in baseline.tunable.items():
            tuned_here = {s: tuned_parameters(name, built[s]).get(each) for s in DESIGNABLE}
            values = ", ".join(
                f"{s} {value:.4g}" for s, value in tuned_here.items() if value is not None
            )
            kind = "logarithmic" if t.logarithmic else "linear"
            tuned.append(
                (f"`{name}`", f"`{each}`", f"{t.low:g} to {t.high:g}, {kind}", f"{t.default:g}", values)
            )
    return "\n".join([
        "# Controllers and their parameters\n",
        NOTE,
        "Every name is one that `shake compare --controllers` and `make_baseline` take. "
        "[Which one, and when](../controllers.md) has the numbers.\n",
        table(("name", "what it is", "information", "can be designed for"), rows),
        "Information: "
        + "; ".join(f"*{name}*: {text}" for name, text in MEANINGS.items())
        + ". *Preview* where the scenario shows one, else *causal*. A policy uses all that its scenario "
        "shows. `oracle` and no other has *true plant*. Costs are comparable within a class "
        "(`baselines.information`).\n",
        "`records` has the laboratory's table, and takes what suits `laboratory`.\n",
        "## Free parameters\n",
        "What `shake tune` searches, and what it found for each scenario (`baselines/tuned.json`). "
        "Where nothing was tuned, as on a scenario that is changed, the default holds, or the values of "
        "`--tuned FILE`.\n",
        table(("controller", "parameter", "range", "default", "tuned"), tuned),
    ])  # fmt: skip


def columns() -> str:
    """Return the page of the columns of results."""
    rows = [(f"`{name}`", column.unit, column.meaning) for name, column in COLUMNS.items()]
    return "\n".join([
        "# Columns of results\n",
        NOTE,
        "`Comparison.to_frame(\"episodes\")`, `\"summaries\"` and `\"traces\"` return pandas frames, "
        "`shake compare --output DIR` writes `episodes.csv` and `summary.csv`, and `--json` has the "
        "same names. `frame.attrs[\"units\"]` holds the units. A ratio has the unit `-`, a count `1`.\n",
        table(("column", "unit", "meaning"), rows),
        """```python
from agents.evaluation import compare
from shake_env import make_scenario

result = compare(make_scenario("linear", {"duration": 2.0}), ("lqr", "none"), noise=4, records=False)
frame = result.to_frame()
print(frame.groupby("controller")[["cost", "base_shear_rms_error"]].mean())
assert frame.attrs["units"]["peak_current"] == "A"
```
""",
    ])  # fmt: skip


def command_line() -> str:
    """Return the page of the commands: their purpose and what to try, from their docstrings."""
    names = (field.name.replace("_", "-") for field in fields(ExecutionOptions))
    execution = ", ".join(f"`--{name}`" for name in names)
    parts = [
        "# Command line\n", NOTE,
        "`shake COMMAND --help` lists every option with its unit. `--json` prints one object on "
        "standard output and nothing else there; `--quiet` prints errors only; `--verbose` says on "
        "standard error what takes time, and where an error was raised. An error in what was asked "
        "returns 2, an interruption 130.\n",
        "Options that change a scenario are common to most commands: `shake COMMAND --help-scenario` "
        "lists them. Wherever a scenario's name is taken, the path of a "
        "[scenario file](../howto/files.md) is taken as well; Python's `make_scenario` takes it, too.\n",
        "Options of where work runs are common to the commands that can share it among processes and "
        f"[machines](../howto/cluster.md): {execution}.\n",
        "Without `--output` a folder of results is the next free one of `out/NAME`, `out/NAME-2`, and "
        "so on. A folder that `--output` names must be new or empty, unless `--force` is given. A "
        "file that an option names is replaced.\n",
        "On a narrow terminal a table continues in a second block below. In a pipe it has one line a "
        "row, whatever the width.\n",
        "Completion of commands and options, once for a shell:\n",
        "```sh\nshake --tyro-print-completion bash > ~/.shake-completion\n"
        "echo 'source ~/.shake-completion' >> ~/.bashrc\n```\n",
        "`zsh` and `tcsh` in place of `bash` print theirs.\n",
    ]  # fmt: skip
    for name, entry in COMMANDS.items():
        command = entry.load()
        text, _, tries = (command.__doc__ or "").partition("Try:")
        lines = [line.strip() for line in text.strip().splitlines()]
        parts += [f"## shake {name}\n", "\n".join(lines).strip() + "\n"]
        examples = [line.strip() for line in tries.strip().splitlines()]
        parts.append("```sh\n" + "\n".join(examples) + "\n```\n")
        common = {"scenario", "execution", *(f.name for f in fields(FolderOptions))}
        own = [f.name for f in fields(command) if f.name not in common]
        options = ", ".join(f"`{option.replace('_', '-')}`" for option in own)
        shared = "execution" in {f.name for f in fields(command)}
        where = "; and those of where work runs" if shared else ""
        parts.append(f"Options of its own: {options or 'none'}{where}.\n")
    return "\n".join(parts)
