"""Results of a campaign: every arena's policies and rivals under the protocol, kept while they hold."""

from __future__ import annotations

import json
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
    """Return the file of an arena's result, the result, and whether it was made now.

    A result holds as long as its policies, rivals and earthquakes are the same; the code's version
    is not asked, for most changes of it touch no figure: `again` asks for a new one.
    """
    file = results / f"{PREFIX}{arena.name}.json"
    scenario = arena.options.build()
    rows = [contestant(str(runs), scenario) for runs in policy_folders(arena, folder)]
    rows += [Contestant(name) for name in arena.rivals]
    wanted = _identity(rows, arena)
    if file.exists() and not again:
        known = json.loads(file.read_text(encoding="utf-8"))
        if known.get("identity") == wanted:
            return file, known, False
    result = evaluate(
        scenario,
        rows,
        earthquakes=arena.earthquakes,
        repeats=arena.fidelity,
        on_progress=on_progress,
    )
    result |= {"arena": arena.name, "identity": wanted}
    write_result(result, file)
    return file, result, True


def _identity(rows: list[Contestant], arena: Arena) -> dict[str, Any]:
    return {
        "earthquakes": arena.earthquakes,
        "rows": {row.name: [source["sha256"] for source in row.sources] for row in rows},
    }
