"""The figure of the performance page: rates by tables, and the cost of a step by each of its sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.ticker import FormatStrFormatter, NullLocator

from agents.figure_style import CONTROLLERS, figure_style, new_figure

PEER = "gymnax CartPole-v1, stepped"
NAMES = ("CartPole-v1", "linear", "linear, recorded motion", "laboratory", "yielding")


def draw(results: dict[str, Any], folder: Path) -> Path:
    """Draw the results of the groups `vector`, `scaling` and, if there are any, `peers`."""
    with figure_style():
        figure = new_figure(9.0, 3.8)
        left, right = figure.subplots(1, 2)
        _rates(left, results)
        _costs(right, results["scaling"])
        file = folder / "benchmarks.png"
        figure.savefig(file, metadata={"Software": None})
        return file


def _rates(axes: Any, results: dict[str, Any]) -> None:
    rates: dict[str, dict[int, float]] = {}
    for groups in (results["vector"], results.get("peers", {})):
        for title, each in groups.items():
            for name in (*NAMES, PEER) if isinstance(each, dict) else ():
                if name in each and not (name in NAMES and groups is not results["vector"]):
                    rates.setdefault(name, {})[int(title.split()[0])] = each[name]
    for (name, line), style in zip(rates.items(), CONTROLLERS, strict=False):
        axes.loglog(list(line), list(line.values()), **style, markersize=5.0, label=name)
    tables = [int(name.split()[0]) for name in results["vector"]]
    axes.set(xlabel="tables [-]", ylabel="table-steps a second [1/s]", xticks=tables)
    axes.xaxis.set_major_formatter(FormatStrFormatter("%d"))
    axes.xaxis.set_minor_locator(NullLocator())
    _room_for_the_legend(axes)


def _costs(axes: Any, cases: dict[str, Any]) -> None:
    for (name, case), style in zip(cases.items(), CONTROLLERS, strict=False):
        sizes = [float(size) for size in case["seconds"]]
        times = list(case["seconds"].values())
        axes.loglog(
            [size / sizes[0] for size in sizes],
            [time / times[0] for time in times],
            **style,
            markersize=5.0,
            label=f"{name}, from {sizes[0]:g}: power {case['exponent']:.2f}",
        )
    axes.set(xlabel="size, beside the smallest [-]", ylabel="time of a step, beside the smallest's [-]")
    _room_for_the_legend(axes)


def _room_for_the_legend(axes: Any) -> None:
    """Put the legend into the upper left, and make it free: lines begin low and rise to the right."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high * (high / low) ** 0.55)
    axes.legend(loc="upper left", fontsize=8.5)
