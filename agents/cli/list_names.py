"""The command ``shake list``: every name that other commands take, with a line on each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import tyro
from rich.console import Console

from agents.cli.command_options import CommandOptions
from agents.reporting.terminal import print_table

Kind = Literal["scenarios", "tables", "controllers", "policies", "records"]


@dataclass(frozen=True, kw_only=True)
class List(CommandOptions):
    """List the names of scenarios, tables, controllers, policies and records, with a line on each.

    Try:
      shake list
      shake list controllers
      shake list records --json
    """

    kinds: tyro.conf.Positional[tuple[Kind, ...]] = ()
    """What to list (default: all five)."""

    def run(self, console: Console) -> dict[str, Any]:
        """Print a table a kind."""
        result: dict[str, Any] = {}
        for kind in self.kinds or tuple(LISTED):
            names = result[kind] = LISTED[kind]()
            print_table(console, (kind, ""), [*names.items()], left=(1,), fold=1)
            if not console.is_terminal:
                console.print()
        return result


def scenarios() -> dict[str, str]:
    """Return the named scenarios, and what each is."""
    from shake_env.scenario.presets import NAMED

    return {name: _first_sentence(make.__doc__) for name, make in NAMED.items()}


def tables() -> dict[str, str]:
    """Return the tables that have a name, and what each is and can do."""
    from shake_env.scenario.tables import TABLE_NAMES, named_table

    summaries = {}
    for name in TABLE_NAMES:
        table = named_table(name)
        summaries[name] = (
            f"{table.title}: {table['table_mass']:g} kg, ±{1e3 * table['stroke']:g} mm, "
            f"{table['velocity']:g} m/s, {1e-3 * table.force:.3g} kN, input in {table.input_unit}"
        )
    return summaries


def controllers() -> dict[str, str]:
    """Return the designed controllers and the oracle, and what each is."""
    from agents.policies import registry

    return {e.name: e.summary for e in registry.controllers().values() if e.kind != "shipped"}


def policies() -> dict[str, str]:
    """Return the algorithms of the policies that ship, and the files of each."""
    from agents.policies import registry

    return {e.name: e.summary for e in registry.controllers().values() if e.kind == "shipped"}


def records() -> dict[str, str]:
    """Return the embedded records, with their peak, length and source."""
    from shake_env import RECORD_NAMES, load_record

    summaries = {}
    for name in RECORD_NAMES:
        record = load_record(name)
        source = dict(record.attribution)
        peak = float(abs(record.acceleration).max())
        origin = ", ".join(source[key] for key in ("event", "station") if key in source)
        summaries[name] = f"{peak:.3g} m/s² peak, {record.duration:.0f} s; {origin}"
    return summaries


LISTED: dict[Kind, Callable[[], dict[str, str]]] = {
    "scenarios": scenarios,
    "tables": tables,
    "controllers": controllers,
    "policies": policies,
    "records": records,
}


def _first_sentence(text: str | None) -> str:
    sentence = (text or "").strip().partition("\n\n")[0].partition(".")[0]
    sentence = " ".join(sentence.removeprefix("Return ").split())
    return sentence[:1].upper() + sentence[1:] + "."
