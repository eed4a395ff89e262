"""Write the reference pages that come from code, and the README's table of results from their files.

    python docs/generate.py

A test holds the pages against what this would write, so that they cannot fall behind.
"""

from __future__ import annotations

import ast
import json
import math
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))  # this checkout, whatever is installed

from agents.cli.command_options import FolderOptions  # noqa: E402
from agents.cli.commands import COMMANDS  # noqa: E402
from agents.evaluation.results import COLUMNS  # noqa: E402
from agents.reporting.evaluation_tables import cost_interval, interval  # noqa: E402
from agents.reporting.markdown_blocks import with_block  # noqa: E402
from agents.studies.laboratory_results import laboratory_tables  # noqa: E402
from baselines.catalogue import BASELINES  # noqa: E402
from baselines.information import MEANINGS  # noqa: E402
from baselines.registry import reference_name, tuned_parameters  # noqa: E402
from shake_env import SCENARIO_NAMES, make_scenario  # noqa: E402
from shake_env.errors import ShakeError  # noqa: E402
from shake_env.model.ranges import RANGES  # noqa: E402
from shake_env.scenario.field_table import MISSING, fields_of  # noqa: E402
from shake_env.scenario.forms import FORMS  # noqa: E402
from shake_env.scenario.json_schema import scenario_schema  # noqa: E402
from shake_env.scenario.scenario import Scenario  # noqa: E402
from shake_env.scenario.scenario_file import flattened  # noqa: E402
from shake_env.scenario.scenario_writer import SCHEMA_FILE  # noqa: E402
from shake_env.scenario.tables import TABLE_NAMES, named_table  # noqa: E402

NOTE = "<!-- Made by docs/generate.py from the code. -->\n"
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
PACKAGES = {
    "shake_env": "Physics and the Gymnasium environment: numpy, SciPy, Gymnasium, array-api-compat.",
    "baselines": "Classical controllers, each a `Controller`.",
    "agents": "Learning, comparison and the command line: what needs torch, SB3 or a terminal.",
}
# Rooms in reading order; modules at the top of a package come first.
TOPICS = {
    "shake_env": (
        "model", "scenario", "motion", "records", "dynamics", "simulation", "safety", "rendering",
        "kernels",
    ),
    "baselines": ("lqr", "estimation", "planning", "servo", "iterative", "analysis"),
    "agents": (
        "policies", "evaluation", "training", "learning", "experiments", "reporting", "motions",
        "studies", "cli",
    ),
}  # fmt: skip
SB3_GUIDE = DOCS / "howto" / "train_with_sb3.md"
TRAINING = DOCS / "training.md"
HEADLINE = ("lqg-searched", "nmpc", "ppo", "apg", "apg-force")  # in the README
DESIGNABLE = ("linear", "as-printed", "laboratory", "unknown-specimen", "yielding")


def table(heading: tuple[str, ...], rows: list[tuple[str, ...]]) -> str:
    """Return a markdown table."""
    lines = [heading, tuple("---" for _ in heading), *rows]
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |\n" for row in lines)


def shown(value: object) -> str:
    """Return a field's value as a reader would type it."""
    if isinstance(value, list):
        return "[" + ", ".join(shown(each) for each in value) + "]"
    if isinstance(value, float):
        return "inf" if math.isinf(value) else f"{value:.6g}"
    return str(value)


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
            found = {s: tuned_parameters(name, built[s]).get(each) for s in DESIGNABLE}
            values = ", ".join(f"{s} {value:.4g}" for s, value in found.items() if value is not None)
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
    parts = [
        "# Command line\n", NOTE,
        "`shake COMMAND --help` lists every option with its unit. `--json` prints one object on "
        "standard output and nothing else there; `--quiet` prints errors only; `--verbose` says on "
        "standard error what takes time, and where an error was raised. An error in what was asked "
        "returns 2, an interruption 130.\n",
        "Options that change a scenario are common to most commands: `shake COMMAND --help-scenario` "
        "lists them. Wherever a scenario's name is taken, the path of a "
        "[scenario file](../howto/files.md) is taken as well; Python's `make_scenario` takes it, too.\n",
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
        common = {"scenario", *(f.name for f in fields(FolderOptions))}
        own = [f.name for f in fields(command) if f.name not in common]
        options = ", ".join(f"`{option.replace('_', '-')}`" for option in own)
        parts.append(f"Options of its own: {options or 'none'}.\n")
    return "\n".join(parts)


def public_modules(package: str) -> list[str]:
    """Return the dotted names of a package's modules that have a docstring, by topic, then by name."""
    names = []
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] == "__main__" or any(part.startswith("_") for part in parts[:-1]):
            continue
        module = parts[:-1] if parts[-1] == "__init__" else parts
        if ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))):
            names.append(".".join(module))
    order = {topic: number for number, topic in enumerate(TOPICS[package])}
    return sorted(names, key=lambda name: (order.get([*name.split("."), ""][1], -1), name))


def own_names(path: Path) -> list[str]:
    """Return the public functions and classes that a file defines itself."""
    kinds = ast.FunctionDef | ast.ClassDef
    body = ast.parse(path.read_text(encoding="utf-8")).body
    return [node.name for node in body if isinstance(node, kinds) and not node.name.startswith("_")]


def api(package: str) -> str:
    """Return a package's API page: a heading a module, its public names below.

    What a package passes on from its modules stands where it is defined, and there alone.
    """
    text = [f"# API, {package}\n", NOTE, PACKAGES[package] + "\n"]
    for module in public_modules(package):
        text.append(f"::: {module}\n")
        start = ROOT.joinpath(*module.split("."), "__init__.py")
        if start.is_file():
            names = own_names(start)
            listed = f" [{', '.join(names)}]" if names else " false"
            text[-1] += f"    options:\n      members:{listed}\n"
    return "\n".join(text)


def headline() -> str:
    """Return the README's two tables of results, costs and base-shear errors, from the result files.

    Costs are over the true bound; over the reference's where a result was made without one.
    """
    costs, errors = [], []
    for name in SCENARIO_NAMES:
        file = DOCS / "results" / f"evaluation_{name}.json"
        if not file.exists():  # not evaluated yet
            continue
        result = json.loads(file.read_text(encoding="utf-8"))
        entries = {row["controller"]: row for row in result["rows"]}
        reference = result["reference"]
        bounded = result["normaliser"] == "bound"
        figure, normaliser = ("relative_cost", "bound") if bounded else ("reference_cost", reference)
        costs.append((
            f"`{name}`",
            normaliser,
            f"`{reference}` {cost_interval(entries[reference][figure])}",
            *(cost_interval(entries[each][figure]) if each in entries else "-" for each in HEADLINE),
        ))  # fmt: skip
        errors.append(
            (
                f"`{name}`",
                *(
                    shear_error(entries[each]) if each in entries else "-"
                    for each in (reference, *HEADLINE)
                ),
            )
        )
    columns = [f"`{name}`" for name in HEADLINE]
    return "\n".join([
        table(("cost", "over", "reference", *columns), costs),
        table(("base-shear error [% rms]", "reference", *columns), errors),
    ])  # fmt: skip


def shear_error(row: dict[str, Any]) -> str:
    """Return a row's base-shear error in percent and, where there are any, its failed tests."""
    failed = f", {row['failures']} of {row['episodes']} failed" if row["failures"] else ""
    return interval(row["base_shear_rms_error"], 1, 100.0) + failed


def compared_tables() -> str | None:
    """Return the comparison of every named table from ``results/table_NAME.json``; None: not all there.

    Each is what ``shake compare --table NAME ... --json`` printed.
    """
    files = {name: DOCS / "results" / f"table_{name}.json" for name in TABLE_NAMES}
    if not all(file.exists() for file in files.values()):
        return None
    rows = []
    for name, file in files.items():
        result = json.loads(file.read_text(encoding="utf-8"))
        for row in result["summaries"]:
            rows.append((
                name,
                f"`{row['controller']}`",
                row["information"],
                f"{row['relative_cost']:.3g}",
                f"{100 * row['acceleration_rms_error']:.2g}",
                f"{100 * row['base_shear_rms_error']:.2g}",
                str(row["broken_limits"]),
            ))  # fmt: skip
    head = (
        "table", "controller", "information", "cost / lqg", "acceleration error [%]",
        "base-shear error [%]", "ended by a limit",
    )  # fmt: skip
    return table(head, rows)


PLANNED_SCENARIOS = ("laboratory", "yielding", "unknown-specimen", "records")
PLANNERS = ("nmpc", "nmpc-adaptive", "planned")


def planning_figures() -> str | None:
    """Return the planners' costs over the bound from the evaluation's results; None: without bounds."""
    rows = []
    for name in PLANNED_SCENARIOS:
        file = DOCS / "results" / f"evaluation_{name}.json"
        result = json.loads(file.read_text(encoding="utf-8"))
        if not result.get("bound", {}).get("costs"):
            return None
        entries = {row["controller"]: row for row in result["rows"]}
        bounds = result["bound"]["costs"]
        lost = ", ".join(
            f"`{each}` {entries[each]['failures']} of {entries[each]['episodes']}"
            for each in PLANNERS
            if each in entries and entries[each]["failures"]
        )
        rows.append((
            f"`{name}`",
            f"{sum(bounds) / len(bounds):.4g} ({len(bounds)})",
            f"`{result['reference']}` {cost_interval(entries[result['reference']]['relative_cost'])}",
            *(cost_interval(entries[p]["relative_cost"]) if p in entries else "-" for p in PLANNERS),
            lost or "none",
        ))  # fmt: skip
    head = (
        "cost / bound", "bound (earthquakes)", "reference", *(f"`{p}`" for p in PLANNERS), "failed",
    )  # fmt: skip
    return table(head, rows)


def sb3_guide() -> str:
    """Return the table of the guide's runs, a row for each setting, with the costs of its seeds."""
    runs = json.loads((DOCS / "results" / "sb3_guide.json").read_text(encoding="utf-8"))
    rows = []
    for variant in dict.fromkeys(run["variant"] for run in runs):
        of_it = [run for run in runs if run["variant"] == variant]
        costs = ", ".join(f"{run['ratio']:.3g}" for run in of_it)
        seconds = ", ".join(f"{run['seconds']:.0f}" for run in of_it)
        steps = f"{of_it[0]['steps']:,}".replace(",", " ")
        rows.append((variant, steps, costs, seconds))
    return table(("setting", "steps", "cost / LQR's cost, one seed each", "processor time [s]"), rows)


def gradient_noise() -> str:
    """Return the table of the estimators of a gradient beside the exact one."""
    result = json.loads((DOCS / "results" / "gradient_noise.json").read_text(encoding="utf-8"))
    rows = [
        (
            each["estimator"],
            f"{100.0 * each['action_share']:.2g} %",
            f"{each['cosine']:.2f}",
            f"{each['along']:.2f} +- {each['along_error']:.2f}",
            f"{each['samples']:,}".replace(",", " "),
        )
        for each in result["estimators"]
    ]
    heading = ("advantage", "share of one action", "cosine", "of the exact gradient", "samples for 1")
    return table(heading, rows)


def pages() -> dict[Path, str]:
    """Return every generated page by its path."""
    made = {
        DOCS / "reference" / "scenarios.md": scenarios(),
        DOCS / "reference" / "tables.md": tables(),
        DOCS / "reference" / "controllers.md": controllers(),
        DOCS / "reference" / "columns.md": columns(),
        DOCS / "reference" / "command-line.md": command_line(),
        ROOT / "shake_env" / "scenario" / SCHEMA_FILE: json.dumps(scenario_schema(), indent=1) + "\n",
        ROOT / "README.md": with_block(ROOT / "README.md", "headline", headline()),
        SB3_GUIDE: with_block(SB3_GUIDE, "sb3 guide", sb3_guide()),
        TRAINING: with_block(TRAINING, "gradient noise", gradient_noise()),
    }
    for page, place, text in (
        (DOCS / "tables.md", "tables compared", compared_tables()),
        (DOCS / "planning.md", "planning", planning_figures()),
        (DOCS / "updating.md", "laboratory figures", laboratory_tables(DOCS / "results")),
    ):
        if text is not None:
            made[page] = with_block(page, place, text)
    return made | {DOCS / "api" / f"{package}.md": api(package) for package in PACKAGES}


if __name__ == "__main__":
    for path, text in pages().items():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        print(f"wrote {path.relative_to(ROOT)}")
