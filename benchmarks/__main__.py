"""``OMP_NUM_THREADS=1 python -m benchmarks``: speed beside peers and beside the machine's limits.

What is compared is measured in turns (`timing`), with one thread for matrix products. ``--only``
measures some groups and takes the others from the file of ``--json``; without a name after it, all.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from threadpoolctl import threadpool_limits

from agents.reporting.markdown_blocks import put_block
from benchmarks.arithmetic import closed_loops, kernel
from benchmarks.decision import decisions
from benchmarks.device import device
from benchmarks.environments import resets, single, threads, vectors
from benchmarks.figure import draw
from benchmarks.footprint import footprint
from benchmarks.learning import learning
from benchmarks.page import tables
from benchmarks.peers import peers
from benchmarks.scaling import scaling


def machine() -> dict[str, Any]:
    """Return what the numbers depend on."""
    model = platform.processor()
    if Path("/proc/cpuinfo").exists():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        model = next((line.split(":")[1].strip() for line in lines if "model name" in line), model)
    return {
        "processor": model,
        "cores": os.cpu_count(),
        "load before": os.getloadavg()[0],
        "python": platform.python_version(),
        "numpy": np.__version__,
        "gymnasium": gymnasium.__version__,
    }


def groups(quick: bool) -> dict[str, Callable[[], dict[str, Any]]]:
    """Return the benchmarks by name, in the order of the page."""
    spell, spells = (0.05, 3) if quick else (0.2, 9)
    return {
        "machine": machine,
        "single": lambda: single(spell, spells),
        "vector": lambda: vectors(spell, spells),
        "threads": lambda: threads(spell, spells),
        "resets": lambda: resets(spell, spells),
        "peers": lambda: peers(spell, spells),
        "arithmetic": lambda: kernel(spell, spells),
        "closed loops": lambda: closed_loops(200 if quick else 1000),
        "decision": lambda: decisions(spell, spells),
        "learning": lambda: learning(spell / 4, spells // 3 + 1, quick),
        "device": lambda: device(spell, spells),
        "footprint": lambda: footprint(1 if quick else 5),
        "scaling": lambda: scaling(spell / 4, spells),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    known = groups(quick=False)
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--figure", type=Path, help="draw the figure into this folder")
    parser.add_argument("--page", type=Path, help="renew the tables of this Markdown page")
    parser.add_argument("--quick", action="store_true", help="short spells: a look, not a measurement")
    parser.add_argument(
        "--peers", action="store_true", help="install gymnax into .venv-peers, and measure beside it"
    )
    parser.add_argument(
        "--only",
        nargs="*",
        metavar="GROUP",
        help=f"measure these alone, of {', '.join(known)}; the rest as the file of --json has it",
    )
    asked = parser.parse_args()
    chosen = [name for name in known if name != "peers" or asked.peers]
    results: dict[str, Any] = {}
    if asked.only is not None:
        if unknown := set(asked.only) - set(known):
            parser.error(f"no such group: {', '.join(sorted(unknown))}; there are {', '.join(known)}")
        if "peers" in asked.only and not asked.peers:
            parser.error("peers installs gymnax: ask for it, --peers")
        extending = asked.json is not None and asked.json.exists()
        if (asked.page or asked.figure) and not extending:
            parser.error("--page and --figure need all groups: --json FILE has what --only leaves out")
        chosen = [name for name in known if name in asked.only]
        if asked.json and asked.json.exists():
            results = json.loads(asked.json.read_text(encoding="utf-8"))
    with threadpool_limits(1):
        for name in chosen:
            results[name] = groups(asked.quick)[name]()
            results = {each: results[each] for each in known if each in results}
            if asked.json:  # after each, so that one that fails does not lose the others
                asked.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    made = tables(results)
    for name, lines in made.items():
        print(f"\n{name}\n", *lines, sep="\n")
    if asked.page:
        for name, lines in made.items():
            put_block(asked.page, name, "\n".join(lines))
    if asked.figure:
        asked.figure.mkdir(parents=True, exist_ok=True)
        print(draw(results, asked.figure), file=sys.stderr)


if __name__ == "__main__":
    main()
