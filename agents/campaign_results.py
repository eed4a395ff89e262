"""Results of a campaign: every arena's policies and rivals under the protocol, row by row."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agents.evaluate import Contestant, contestant, evaluate
from agents.recipes import Arena
from agents.result_tables import PREFIX, write_result


def policy_folders(arena: Arena, folder: Path) -> list[Path]:
    """Return the folders of runs, one an algorithm, whose policies an arena takes."""
    own = folder / (arena.trained_on or arena.name)
    return sorted({file.parents[1] for file in own.glob("*/*/policy.safetensors")})


def evaluate_arena(
    arena: Arena,
    folder: Path,
    results: Path,
    *,
    again: bool = False,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> tuple[Path, dict[str, Any], bool]:
    """Return the file of an arena's result, the result, and whether any of it was made now.

    A row holds while there is no policy for it that it was not made of, and a rival's while it is in the
    file: a row whose policies lie on no disk here any more stays. What does not hold is run, and with it
    the reference and the yardstick, which must fare as they did. The code's version is not asked, for
    most changes of it touch no figure: `again` asks for all rows anew, of the policies that there are.

    Raises
    ------
    ParameterError
        If rows are to stay, but reference or yardstick fare otherwise than when those were made.
    """
    file = results / f"{PREFIX}{arena.name}.json"
    scenario = arena.options.build()
    rows = [contestant(str(runs), scenario) for runs in policy_folders(arena, folder)]
    rows += [Contestant(name) for name in arena.rivals]
    known = None
    if file.exists() and not again:
        known = json.loads(file.read_text(encoding="utf-8"))
        if known["identity"]["earthquakes"] != arena.earthquakes:
            known = None
    missing = [row for row in rows if known is None or not _holds(row, known["identity"]["rows"])]
    if known is not None and not missing:
        return file, known, False
    result = evaluate(
        scenario,
        missing,
        earthquakes=arena.earthquakes,
        repeats=arena.fidelity,
        known=known,
        on_progress=on_progress,
    )
    result |= {"arena": arena.name, "identity": _identity(result, arena)}
    write_result(result, file)
    return file, result, True


def _holds(row: Contestant, known: dict[str, list[str]]) -> bool:
    return row.name in known and Counter(s["sha256"] for s in row.sources) <= Counter(known[row.name])


def _identity(result: dict[str, Any], arena: Arena) -> dict[str, Any]:
    return {
        "earthquakes": arena.earthquakes,
        "rows": {row["controller"]: [s["sha256"] for s in row["sources"]] for row in result["rows"]},
    }
