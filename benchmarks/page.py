"""The measured numbers as Markdown tables."""

from __future__ import annotations

from collections.abc import Iterable
from textwrap import wrap
from typing import Any

from benchmarks.goals import goals, number


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return ["| " + " | ".join(line) + " |" for line in lines]


def tables(results: dict[str, Any]) -> dict[str, list[str]]:
    """Return the lines of each table, by the name of its markers, of the groups that were measured."""
    makers = {
        "machine": _machine, "single": _single, "vector": _vector, "threads": _vector, "resets": _resets,
        "peers": _peers, "arithmetic": _arithmetic, "closed loops": _closed_loops,
        "decision": _decision, "learning": _learning, "device": _device, "footprint": _footprint,
        "scaling": _scaling,
    }  # fmt: skip
    made = {name: make(results[name]) for name, make in makers.items() if name in results}
    return {"goals": _goals(results), **made}


def _goals(results: dict[str, Any]) -> list[str]:
    every = goals(results)
    lines = ["| | goal | measured | measured / goal | met |", "|---|---|---|---|---|"]
    lines += [goal.row() for goal in every]
    reasons = dict.fromkeys(goal.why for goal in every if not goal.met and goal.why)
    for why in reasons:
        missed = [goal.what for goal in every if not goal.met and goal.why == why]
        lines += ["", *wrap(f"Missed: {'; '.join(missed)}. {why}", 118, break_on_hyphens=False)]
    return lines


def _machine(machine: dict[str, Any]) -> list[str]:
    return [", ".join(f"{key}: {value}" for key, value in machine.items()) + "."]


def _single(rates: dict[str, float]) -> list[str]:
    cart = rates["CartPole-v1"]
    rows = [(name, number(rate), f"{rate / cart:.2f}") for name, rate in rates.items()]
    return table(("", "steps/s", "beside CartPole-v1"), rows)


def _vector(results: dict[str, dict[str, float]]) -> list[str]:
    names = dict.fromkeys(name for rates in results.values() for name in rates)
    rows = [
        (name, *(f"{rates[name] / 1e6:.2f} M" if name in rates else "" for rates in results.values()))
        for name in names
    ]
    return table(("table-steps/s", *results), rows)


def _resets(seconds: dict[str, float]) -> list[str]:
    rows = [(name, f"{1e3 * each:.3f}") for name, each in seconds.items()]
    return table(("", "a reset [ms]"), rows)


def _peers(results: dict[str, Any]) -> list[str]:
    if "unavailable" in results:
        return [f"gymnax could not be installed: {results['unavailable']}"]
    return _vector(results)


def _arithmetic(rates: dict[str, float]) -> list[str]:
    peak = rates["matrix product 768 x 768"]
    rows = [(name, f"{rate:.2f}", f"{peak / rate:.1f}") for name, rate in rates.items()]
    return table(("", "1e9 multiply-adds/s", "the peak beside it"), rows)


def _closed_loops(results: dict[str, float]) -> list[str]:
    ways = ("blocks", "textbook batch", "scipy dlsim")
    rows = [(name, f"{results[name]:.3g}", f"{results[name] / results['blocks']:.1f}") for name in ways]
    lines = table((f"{results['earthquakes']} earthquakes", "s", "beside blocks"), rows)
    return [*lines, "", f"Largest relative difference: {results['largest relative difference']:.0e}."]


def _decision(results: dict[str, dict[str, float]]) -> list[str]:
    rows = [
        (
            name,
            f"{1e6 * times['numpy']:.0f}",
            f"{1e6 * times['SB3']:.0f}",
            f"{times['SB3'] / times['numpy']:.1f}",
            f"{times['largest difference']:.0e}",
        )
        for name, times in results.items()
    ]
    return table(("", "numpy [us]", "SB3 [us]", "SB3 / numpy", "actions differ by"), rows)


def _learning(results: dict[str, Any]) -> list[str]:
    rows = [
        (
            name,
            *(f"{100.0 * shares[key]:.1f} %" for key in ("share of roll-outs", "share of all")),
            f"{1e6 * shares['a period of 64 tables [s]']:.0f} us",
        )
        for name, shares in results["PPO"].items()
    ]
    lines = table(("PPO, 64 tables", "of roll-outs", "of all time", "a period"), rows)
    ours, theirs = (results["samples/s"][name] for name in ("linear", "CartPole-v1"))
    whole = (
        f"PPO of the same size and settings, whole, by the wall clock: {number(ours)} samples a second "
        f"on `linear`, {number(theirs)} on SB3's CartPole-v1 ({ours / theirs:.1f} times)."
    )
    lines += ["", *wrap(whole, 118)]
    for name, ways in results["gradient"].items():
        windows = list(ways["forward"]["seconds"])
        forward = ways["forward"]["seconds"]
        rows = [("forward pass [ms]", *(f"{1e3 * forward[w]:.0f}" for w in windows), "time")]
        for way in ("gradient", "in segments"):
            seconds = ways[way]["seconds"]
            ratios = (f"{seconds[w] / forward[w]:.2f}" for w in windows)
            rows.append((f"{way}, beside the forward pass", *ratios, "time"))
        for way in ("gradient", "in segments"):
            memory = ways[way]["bytes"]
            if memory is not None:
                rows.append((f"{way} [MiB]", *(f"{memory[w] / 2**20:.0f}" for w in windows), "memory"))
        places = {"forward pass [ms]": "forward"}
        powers = [
            ways[places.get(row[0], "in segments" if row[0].startswith("in") else "gradient")][
                f"exponent of {row[-1]}"
            ]
            for row in rows
        ]
        rows = [(*row[:-1], f"{power:.2f}") for row, power in zip(rows, powers, strict=True)]
        lines += ["", *table((f"{name}, window", *windows, "grows to the power"), rows)]
    return lines


def _device(results: dict[str, Any]) -> list[str]:
    names = [name for name, each in results.items() if isinstance(each, dict) and name != "updates"]
    sizes = list(results[names[0]]["rates"])
    rows = [
        (
            name,
            *(f"{results[name]['rates'][size] / 1e6:.2f} M" for size in sizes),
            f"{results[name]['bytes']:,} B".replace(",", " "),
            f"{results[name]['limit'] / 1e6:.0f} M",
        )
        for name in names
    ]
    head = ("table-steps/s, float32", *(f"{size} tables" for size in sizes), "a step moves", "limit")
    line = f"Device: {results['device']}; a copy moves {results['bandwidth [B/s]'] / 1e9:.1f} GB/s."
    lines = [*table(head, rows), "", line]
    if "updates" in results:
        one = {"cpu": "cpu, one thread"}
        kinds = [one.get(kind, kind) for kind in results["updates"]["gradient"]]
        rows = [(way, *(f"{s:.2f}" for s in each.values())) for way, each in results["updates"].items()]
        lines += ["", *table(("an update, wall time [s]", *kinds), rows)]
    return lines


def _footprint(results: dict[str, Any]) -> list[str]:
    rows = [(name, f"{v:.2f}" if isinstance(v, float) else str(v)) for name, v in results.items()]
    return table(("", ""), rows)


def _scaling(results: dict[str, Any]) -> list[str]:
    rows = []
    for name, case in results.items():
        smallest, *_, largest = case["seconds"]
        rows.append((name, f"{smallest} to {largest}", f"{case['exponent']:.2f}"))
    return table(("size", "tried", "cost grows as its power"), rows)
