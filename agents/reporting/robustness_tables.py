"""A robustness result in words, as a table, as a file, and on its page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from agents.reporting.markdown_blocks import markdown_table
from agents.run_directory import read_json
from shake_env.errors import ParameterError
from shake_env.files import write_text

PREFIX = "robustness_"
MATTERS = (
    1.02  # a cost beyond this multiple of another's is called larger: what fewer earthquakes can tell
)
Point = dict[str, Any]


def point_at(result: dict[str, Any], **values: float) -> Point:
    """Return a robustness result's point with these values of quantities and nothing else changed.

    Raises
    ------
    ParameterError
        If the result has no such point.
    """
    nominal = {q["name"]: q["nominal"] for q in result["quantities"] if q["trained"] is None}
    changes = {name: value for name, value in values.items() if nominal.get(name) != value}
    for point in result["points"]:
        if point["changes"] == changes:
            typed_point: Point = point
            return typed_point
    raise ParameterError("point", values, "is not in the result: run shake robustness with it")


def sweep_points(result: dict[str, Any], quantity: dict[str, Any]) -> list[Point]:
    """Return the points of a quantity's sweep in a robustness result, ascending."""
    return [point_at(result, **{quantity["name"]: value}) for value in quantity["values"]]


def classical_controllers(result: dict[str, Any]) -> list[str]:
    """Return the names of a robustness result's controllers that are no policies."""
    return [each["name"] for each in result["controllers"] if each["source"] is None]


def controller_label(each: dict[str, Any]) -> str:
    """Return a controller's name, with a policy's algorithm where the name does not say it."""
    name, algorithm = each["name"], (each["source"] or {}).get("algorithm")
    short = Path(name).name if "/" in name else name
    return short if algorithm in (None, short) else f"{short} ({algorithm})"


def range_in_words(values: Sequence[float], chosen: Sequence[bool], unit: str) -> str:
    """Return which of a sweep's ascending values are chosen, in words: up to, from, at, to, every."""
    if all(chosen):
        return "at every value"
    parts, last = [], len(values) - 1
    for begin, end in _runs(chosen):
        low, high = f"{values[begin]:.3g}", f"{values[end]:.3g}"
        if begin == 0 and end > 0:
            parts.append(f"up to {high}")
        elif end == last and begin < last:
            parts.append(f"from {low}")
        else:
            parts.append(f"at {low}" if begin == end else f"from {low} to {high}")
    return " and ".join(parts) + ("" if unit == "-" else f" {unit}") if parts else "nowhere"


def _runs(chosen: Sequence[bool]) -> list[tuple[int, int]]:
    """Return first and last place of each run of chosen ones."""
    runs: list[tuple[int, int]] = []
    for place, each in enumerate(chosen):
        if each and runs and runs[-1][1] == place - 1:
            runs[-1] = (runs[-1][0], place)
        elif each:
            runs.append((place, place))
    return runs


def best_classical(result: dict[str, Any], point: Point) -> str | None:
    """Return the cheapest classical controller of those that lost no test there; None: all lost one."""
    held = [name for name in classical_controllers(result) if not point["failures"][name]]
    return min(held, key=lambda name: point["cost"][name]) if held else None


def robustness_findings(result: dict[str, Any], controller: str) -> list[str]:
    """Return sentences on where a controller loses tests, and where a classical one costs less."""
    tests, losses, dearer, total = len(result["earthquakes"]), [], [], 0
    for quantity in result["quantities"]:
        points, values = sweep_points(result, quantity), quantity["values"]
        gone = [point["failures"][controller] > 0 for point in points]
        total += sum(point["failures"][controller] for point in points)
        what, unit = quantity["title"], quantity["unit"]
        if any(gone):
            spared = [
                g and best_classical(result, p) is not None for p, g in zip(points, gone, strict=True)
            ]
            beside = (
                f", a classical one none {range_in_words(values, spared, unit)}" if any(spared) else ""
            )
            losses.append(f"{what} {range_in_words(values, gone, unit)}{beside}")
        ratios = [_over_best(result, point, controller) for point in points]
        worse = [ratio > MATTERS for ratio, _ in ratios]
        if any(worse):
            most = max(range(len(points)), key=lambda i: ratios[i][0])
            ratio, name = ratios[most]
            place = f"{values[most]:.3g}" + ("" if unit == "-" else f" {unit}")
            dearer.append(
                f"{what} {range_in_words(values, worse, unit)} ({ratio:.2f} times {name}'s at {place})"
            )
    count = tests * sum(len(quantity["values"]) for quantity in result["quantities"])
    lost = f"Lost {total} of {count} tests: {'; '.join(losses)}." if losses else ""
    sentences = [lost or f"Lost none of {count} tests with one thing changed."]
    if dearer:
        sentences.append(f"Costs more than the best classical controller: {'; '.join(dearer)}.")
    else:
        share = f"{MATTERS - 1.0:.0%}"
        sentences.append(f"Nowhere, where it held, did a classical controller cost {share} less.")
    for each in result["maps"]:
        pairs = [
            point_at(result, **{each["x"]: x, each["y"]: y}) for x in each["xs"] for y in each["ys"]
        ]
        gone = [point for point in pairs if point["failures"][controller]]
        alone = [point for point in gone if best_classical(result, point)]
        if gone:
            title = {q["name"]: q["title"] for q in result["quantities"]}
            also = f", at {len(alone)} of which a classical one lost none" if alone else ""
            sentences.append(
                f"Lost tests at {len(gone)} of {len(pairs)} pairs of {title[each['x']]} and "
                f"{title[each['y']]}{also}."
            )
    return sentences


def _over_best(result: dict[str, Any], point: Point, controller: str) -> tuple[float, str]:
    """Return cost over the best classical controller's, and its name; 0 where there is no ratio."""
    best = best_classical(result, point)
    if best is None or point["failures"][controller]:
        return 0.0, ""
    return point["cost"][controller] / point["cost"][best], best


def robustness_markdown(result: dict[str, Any]) -> str:
    """Return a robustness result as Markdown: cost over the reference's, and where tests were lost."""
    shown = result["controllers"]
    head = ["quantity", "made for", *(controller_label(each) for each in shown)]
    rows = []
    for quantity in result["quantities"]:
        points, values = sweep_points(result, quantity), quantity["values"]
        unit = "" if quantity["unit"] == "-" else f" {quantity['unit']}"
        trained = quantity["trained"] or (quantity["nominal"],)
        cells = [
            f"{quantity['title']}, {values[0]:.3g} to {values[-1]:.3g}{unit}",
            " to ".join(f"{value:.3g}" for value in trained) + unit,
            *(_cell(result, points, values, quantity["unit"], each["name"]) for each in shown),
        ]
        rows.append(cells)
    costs = (result.get("bound") or {}).get("costs")
    if costs:
        nominal, bound = result["points"][0]["cost"], sum(costs) / len(costs)
        rows.append(
            ["nothing: cost / bound", "", *(f"{nominal[each['name']] / bound:.2f}" for each in shown)]
        )
    seed = "recorded" if result["seed"] is None else f"seeds from {result['seed']}"
    return (
        f"{markdown_table(head, rows)}\nCost over {result['reference']}'s, least to most of the values "
        f"where neither lost a test. {len(result['earthquakes'])} earthquakes a value, {seed}; version "
        f"{result['version']} ({result['code']}), {result['machine']}.\n"
    )


def _cell(result: dict[str, Any], points: list[Point], values: list[float], unit: str, name: str) -> str:
    gone = [point["failures"][name] > 0 for point in points]
    held = [
        point["relative_cost"][name]
        for point in points
        if not point["failures"][name] and not point["failures"][result["reference"]]
    ]
    low, high = (f"{f(held):.2f}" for f in (min, max)) if held else ("-", "-")
    text = low if low == high else f"{low} to {high}"
    return f"{text}; lost {range_in_words(values, gone, unit)}" if any(gone) else text


def robustness_section(result: dict[str, Any], pictures: Sequence[Path] = ()) -> str:
    """Return what a page says of a robustness result: pictures, table, and every policy's findings."""
    what = {True: "pairs of things changed", False: "one thing changed at a time"}
    parts = [
        f"![Cost over {result['reference']}'s on {result['scenario']}, "
        f"{what[picture.stem.endswith('_maps')]}]({picture.as_posix()})\n"
        for picture in pictures
    ]
    parts.append(robustness_markdown(result))
    learned = [each for each in result["controllers"] if each["source"] is not None]
    for each in learned or result["controllers"]:
        parts.append(
            f"**{controller_label(each)}.** "
            + " ".join(robustness_findings(result, each["name"]))
            + "\n"
        )
    return "\n".join(parts)


def write_robustness(result: dict[str, Any], file: str | PathLike[str]) -> None:
    """Write a robustness result with a point on a line."""
    file = Path(file)
    head = json.dumps({key: value for key, value in result.items() if key != "points"}, indent=1)[:-2]
    points = ",\n".join(f"  {json.dumps(point)}" for point in result["points"])
    write_text(file, f'{head},\n "points": [\n{points}\n ]\n}}\n')


def read_robustness(file: str | PathLike[str], scenario: str | None = None) -> dict[str, Any]:
    """Return the robustness result that a file holds.

    Parameters
    ----------
    file
        That ``shake robustness`` wrote.
    scenario
        Name of the scenario that it has to be of; None: any.

    Raises
    ------
    ParameterError
        If the file cannot be read, is no result of ``shake robustness``, or of another scenario.
    """
    file = Path(file)
    result = read_json(file, ParameterError, "robustness")
    if not str(result.get("format", "")).startswith("shake-robustness-"):
        raise ParameterError("robustness", str(file), "is no result of shake robustness")
    if scenario not in (None, result["scenario"]):
        other = f"is of {result['scenario']}: run shake robustness --scenario {scenario}"
        raise ParameterError("robustness", str(file), other)
    return result
