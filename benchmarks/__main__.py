"""``OMP_NUM_THREADS=1 python -m benchmarks``: speed beside peers and beside the machine's limits.

Every number comes from this run: what is compared is measured in turns (`timing`), with one thread for
matrix products. gymnax, a peer on jax, is not among them: it would need an environment of its own.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from threadpoolctl import threadpool_limits

from agents.figure_style import CONTROLLERS, figure_style, new_figure, save_figure
from benchmarks.arithmetic import closed_loops, kernel
from benchmarks.environments import single, vectors
from benchmarks.footprint import footprint
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


def measure(quick: bool) -> dict[str, Any]:
    """Run every benchmark."""
    spell, spells = (0.05, 3) if quick else (0.2, 9)
    return {
        "machine": machine(),
        "single": single(spell, spells),
        "vector": vectors(spell, spells),
        "arithmetic": kernel(spell, spells),
        "closed loops": closed_loops(200 if quick else 1000),
        "footprint": footprint(1 if quick else 5),
        "scaling": scaling(spell / 4, spells),
    }


def report(found: dict[str, Any]) -> list[str]:
    """Return the results in lines, with their ratios."""
    lines = ["machine: " + ", ".join(f"{key} {value}" for key, value in found["machine"].items())]
    groups = {"one environment, through gymnasium.make": found["single"]}
    groups |= {f"{tables}, steps of a table": rates for tables, rates in found["vector"].items()}
    for title, rates in groups.items():
        lines.append(title)
        for name, rate in rates.items():
            ratio = rate / rates["CartPole-v1"]
            lines.append(f"  {name:30s} {rate:12,.0f} a second  {ratio:7.2f} times CartPole-v1")
    wide = found["vector"]["1024 tables"]
    each = wide["laboratory"] / wide["laboratory, a specimen each"]
    lines.append(f"a specimen each costs {each:.2f} times a common one (laboratory, 1024 tables)")
    sb3 = found["vector"]["64 tables"]
    ratio = sb3["linear, SB3 VecEnv"] / sb3["CartPole-v1, SB3 DummyVecEnv"]
    lines.append(f"SB3 at 64: {ratio:.1f} times DummyVecEnv with CartPole")
    peak = found["arithmetic"]["matrix product 768 x 768"]
    lines.append("multiply-adds at 1024 tables, n_m = 5")
    for name, rate in found["arithmetic"].items():
        lines.append(f"  {name:30s} {rate:8.2f} e9 a second, the peak is {peak / rate:.1f} times that")
    loops = found["closed loops"]
    lines.append("closed loops of 10 s at 500 Hz")
    for name in ("textbook batch", "scipy dlsim"):
        lines.append(f"  {name}: {loops[name]:.2f} s, {loops[name] / loops['blocks']:.1f} times blocks")
    apart = loops["largest relative difference"]
    lines.append(f"  blocks: {loops['blocks']:.3f} s; largest relative difference {apart:.1e}")
    lines.append(
        "footprint: " + ", ".join(f"{name} {value}" for name, value in found["footprint"].items())
    )
    exponents = {name: case["exponent"] for name, case in found["scaling"].items()}
    lines.append("cost grows as: " + ", ".join(f"{n} ^ {e:.2f}" for n, e in exponents.items()))
    return lines


def draw(found: dict[str, Any], folder: Path) -> list[Path]:
    """Draw the rates by tables, and the costs by size."""
    with figure_style():
        figure = new_figure(9.0, 3.6)
        left, right = figure.subplots(1, 2)
        tables = [int(name.split()[0]) for name in found["vector"]]
        names = ("CartPole-v1", "linear", "linear, recorded motion", "laboratory")
        for name, style in zip(names, CONTROLLERS, strict=False):
            rates = [found["vector"][f"{number} tables"][name] for number in tables]
            left.loglog(tables, rates, label=name, **style)
        left.set(xlabel="tables", ylabel="table-steps a second", xticks=tables, xticklabels=tables)
        left.legend()
        for (name, case), style in zip(found["scaling"].items(), CONTROLLERS, strict=False):
            sizes = [float(size) for size in case["seconds"]]
            times = 1e6 * np.array(list(case["seconds"].values()))
            right.loglog(sizes, times, label=f"{name}: exponent {case['exponent']:.2f}", **style)
        right.set(xlabel="size", ylabel="time of a step [us]")
        right.legend()
        return save_figure(figure, folder, "benchmarks")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the numbers to this file")
    parser.add_argument("--figure", type=Path, help="draw the figure into this folder")
    parser.add_argument("--quick", action="store_true", help="short spells: a look, not a measurement")
    asked = parser.parse_args()
    with threadpool_limits(1):
        found = measure(asked.quick)
    print("\n".join(report(found)))
    if asked.json:
        asked.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    if asked.figure:
        asked.figure.mkdir(parents=True, exist_ok=True)
        print(*draw(found, asked.figure), file=sys.stderr)


if __name__ == "__main__":
    main()
