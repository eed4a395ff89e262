"""A report as one HTML page that needs nothing beside it: text, tables, data, plotting library."""

from __future__ import annotations

import base64
import gzip
import io
import json
from collections.abc import Callable, Sequence
from html import escape
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

import shake_env
from agents.evaluation.bootstrap import mean_interval
from agents.evaluation.controller_set import CLAIRVOYANT
from agents.evaluation.results import GroupSummary
from agents.figure_style import PLOTLY, figure_style
from agents.reporting.report import Report
from agents.reporting.report_data import page_data
from agents.reporting.report_figures import stills
from agents.reporting.report_tracking import tracking_table
from agents.reporting.robustness_figures import figures
from agents.reporting.robustness_tables import findings, label

PLOTLY_FILE = "plotly-basic-4.1.1.min.js.gz"  # plotly.js, basic distribution; MIT, says its first line
Cell = str
Column = tuple[str, Callable[[GroupSummary], Cell]]


def page(report: Report, stills: Sequence[str]) -> str:
    """Return the page.

    Parameters
    ----------
    report
        What is shown.
    stills
        Names of the figures that lie beside the page, without their endings.
    """
    data = page_data(report)
    sections = [
        _tables(report), _trade_off(report), _time(report), _spectra(report, data),
        _hysteresis(data), _transfer(data), _robustness(report, data), _unlike(report),
        _learning(report, data),
    ]  # fmt: skip
    scenario = report.scenario
    count = len(report.comparison.groups)
    title = f"{len(report.controllers)} controllers on {count} earthquake{'s' if count != 1 else ''}"
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="generator" content="shake-env {escape(shake_env.__version__)}">
<title>{title}, {escape(scenario.name)}</title>
<link rel="icon" href="data:,">
<style>{_asset("report.css")}</style>
</head>
<body>
<header>
<h1>{title}</h1>
<p class="soft">{escape(_setting(report))}</p>
</header>
<main>
{_verdict(report)}
{"".join(sections)}
</main>
<footer>
{_footer(report, stills)}
</footer>
<noscript><p>The figures here need JavaScript; as pictures they lie beside this page.</p></noscript>
<script>{gzip.decompress(_bytes(PLOTLY_FILE)).decode("utf-8")}</script>
<script type="application/json" id="report-data">{_json(data)}</script>
<script>{_asset("report.js")}</script>
</body>
</html>
"""


def _bytes(name: str) -> bytes:
    return (resources.files("agents.reporting") / "assets" / name).read_bytes()


def _asset(name: str) -> str:
    return _bytes(name).decode("utf-8")


def _json(data: dict[str, Any]) -> str:
    # "<!--<script>" and "</script>" in a name would change where the element ends: no "<" is left in it.
    return json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _setting(report: Report) -> str:
    scenario = report.scenario
    specimen = scenario.specimen
    stories = specimen.stories
    share = sum(specimen.masses) / scenario.actuator.table_mass
    parts = [
        f"Scenario {scenario.name}",
        f"specimen of {stories} store{'y' if stories == 1 else 'ys'} and {share:.2g} x the table's mass",
        f"control at {scenario.control_rate:g} Hz",
    ]
    if scenario.uncertainty.active:
        parts.append("a plant drawn anew for each earthquake, which no controller is told")
    if report.comparison.interventions:
        parts.append("every controller under a supervisor")
    return ", ".join(parts) + "."


def _verdict(report: Report) -> str:
    heads = ("Who wins", "Where it loses", "What limits it")
    rows = "".join(
        f"<div><dt>{head}</dt><dd>{unbroken(sentence)}</dd></div>\n"
        for head, sentence in zip(heads, report.verdict.sentences, strict=True)
    )
    return f'<dl class="verdict" id="verdict">\n{rows}</dl>'


def unbroken(sentence: str) -> str:
    """Return a sentence as HTML whose numbers keep their percent signs."""
    return escape(sentence).replace(" %", "&nbsp;%")


def _section(identifier: str, heading: str, text: str, body: str) -> str:
    return (
        f'<section aria-labelledby="{identifier}-head"><h2 id="{identifier}-head">{heading}</h2>\n'
        f'<p class="soft">{text}</p>\n{body}</section>\n'
    )


def _plot(identifier: str, words: str) -> str:
    label = escape(words, quote=True)
    return (
        f'<figure><div class="plot" id="{identifier}" role="group" aria-label="{label}"></div></figure>'
    )


# --- tables ---------------------------------------------------------------------------------------


def _tables(report: Report) -> str:
    groups = list(dict.fromkeys(report.comparison.groups))
    body = "".join(_table(report, group) for group in groups)
    if report.comparison.tracking:
        of_group = report.comparison.groups
        members = [i for i, group in enumerate(of_group) if group == report.verdict.group]
        body += tracking_table(report.comparison.tracking, report.labels, members)
    text = (
        "Cost is the sum over a group's earthquakes, relative to the reference's on the same ones. "
        "Errors are rms relative to the target's own rms, mean over earthquakes. Brackets: 95 % "
        "bootstrap intervals over earthquakes. Spectrum: share of response-spectrum ordinates more than "
        "10 % off. Current, velocity and stroke: the largest. Ended early: by a broken limit."
    )
    return _section("figures", "The numbers", text, body)


def _table(report: Report, group: str) -> str:
    rows = [row for row in report.comparison.summaries if row.group == group]
    members = [i for i, each in enumerate(report.comparison.groups) if each == group]
    least = min(row.relative_cost for row in rows if row.controller != CLAIRVOYANT)
    reference = escape(report.labels[report.comparison.reference])
    amperes = report.scenario.input_unit == "A"
    factor, heading = (1e3, "current [mA]") if amperes else (1.0, "input [V]")

    def error(field: str) -> Callable[[GroupSummary], Cell]:
        def cell(row: GroupSummary) -> Cell:
            each = [getattr(report.comparison.episodes[row.controller][i], field) for i in members]
            return _interval(*(100 * value for value in mean_interval(np.array(each))))

        return cell

    columns: list[Column] = [
        (f"cost /<br>{reference}", lambda row: _interval(
            row.relative_cost, row.relative_cost_low, row.relative_cost_high)),
        ("acceleration<br>error [%]", error("acceleration_rms_error")),
        ("base shear<br>error [%]", error("base_shear_rms_error")),
        ("lag [ms]", lambda row: _number(1e3 * row.delay, 1)),
        ("spectrum [%]", lambda row: _number(100 * row.spectral_error, 0)),
        (heading, lambda row: _number(factor * row.peak_current, 0)),
        ("velocity [m/s]", lambda row: _number(row.peak_velocity, 2)),
        ("stroke [mm]", lambda row: _number(1e3 * row.peak_displacement, 0)),
    ]  # fmt: skip
    if any(row.broken_limits for row in rows):
        columns.append(("ended early", lambda row: str(row.broken_limits)))
    if any(np.isfinite(row.decision_time) for row in rows):
        columns.append(("decision [µs]", lambda row: _number(1e6 * row.decision_time, 0)))
    # Values stand under the headings' ends, intervals beyond them.
    kinds = [' class="wide"'] * 3 + [""] * (len(columns) - 3)
    head = "".join(
        f'<th scope="col"{kind}>{heading}</th>'
        for kind, (heading, _) in zip(kinds, columns, strict=True)
    )
    lines = []
    for row in rows:
        best = row.relative_cost == least and row.controller != CLAIRVOYANT
        mark = ' class="best"' if best else ""
        cells = "".join(f"<td>{cell(row)}</td>" for _, cell in columns)
        lines.append(
            f'<tr{mark}><th scope="row">{escape(report.labels[row.controller])}</th>{cells}</tr>'
        )
    number = rows[0].earthquakes
    title = f"{group[:1].upper()}{group[1:]}, {number} earthquake{'s' if number != 1 else ''}"
    note = "the least cost in bold"
    if any(row.controller == CLAIRVOYANT for row in rows):
        note += "; the clairvoyant knows plant and target, and is no candidate"
    return (
        f'<div class="scroll" tabindex="0" role="region" aria-label="Table: {title}"><table>\n'
        f"<caption>{title}; {note}.</caption>\n"
        f'<thead><tr><th scope="col">controller</th>{head}</tr></thead>\n'
        f"<tbody>\n{chr(10).join(lines)}\n</tbody></table></div>\n"
    )


def _number(value: float, digits: int) -> str:
    # Adding zero after rounding turns -0.0 into 0.0.
    return f"{round(value, digits) + 0.0:.{digits}f}" if np.isfinite(value) else "–"  # noqa: RUF001


def _interval(value: float, low: float, high: float) -> str:
    most = high if np.isfinite(high) else value
    digits = 3 if most < 1.0 else 2 if most < 10.0 else 1 if most < 1000.0 else 0
    if not low < high:  # one earthquake has none
        return f'{value:.{digits}f}<span class="interval"></span>'
    inside = f"[{low:.{digits}f}, {high:.{digits}f}]"
    return f'{value:.{digits}f}<span class="interval">{inside}</span>'


# --- figures --------------------------------------------------------------------------------------


def _trade_off(report: Report) -> str:
    text = (
        "Down and left is better. Large marks: means over the earthquakes of the verdict, bars: 95 % "
        "intervals; small marks: each earthquake."
    )
    if report.frontier:
        text += (
            " Grey: what LQR is expected to reach, from caring for acceleration alone to caring for "
            "base shear alone; no law that sees no more lies below it in the long run."
        )
    words = "Acceleration error against base shear error of each controller."
    return _section("trade", "Acceleration against base shear", text, _plot("trade-off", words))


def _time(report: Report) -> str:
    options = []
    names = [quake.name for quake in report.gathered.earthquakes]
    groups = report.comparison.groups
    for group in dict.fromkeys(groups):
        inside = "".join(
            f'<option value="{i}"{" selected" if name == report.comparison.traced else ""}>'
            f"{escape(name)}</option>"
            for i, name in enumerate(names)
            if groups[i] == group
        )
        options.append(f'<optgroup label="{escape(group)}">{inside}</optgroup>')
    boxes = "".join(
        f'<label for="controller-{k}"><input type="checkbox" id="controller-{k}"'
        f"{' checked' if name in report.shown else ''}>{_sample(k)}{escape(report.labels[name])} "
        f'<output id="errors-{k}"></output></label>'
        for k, name in enumerate(report.controllers)
    )
    controls = (
        '<div class="controls">'
        f'<label class="choice" for="earthquake">Earthquake <select id="earthquake">{"".join(options)}'
        "</select></label>"
        '<span><button type="button" id="strong">Strongest 5 s</button> '
        '<button type="button" id="whole">Whole test</button> '
        '<button type="button" id="earlier">Earlier</button> '
        '<button type="button" id="later">Later</button> '
        '<button type="button" id="closer">Closer</button> '
        '<button type="button" id="wider">Wider</button></span> <output id="window"></output>'
        f"<fieldset><legend>Controllers</legend>{boxes}</fieldset></div>\n"
    )
    text = (
        "What the table did and what the specimen felt, against what they should have: drag along a "
        "panel to zoom all of them, click twice for the whole test. The choice holds for the response "
        "spectra below, too. Beside each controller: its rms errors on this earthquake."
    )
    words = (
        "Curves over time of table acceleration, base shear, valve current, load pressure and stroke, "
        "with targets and limits."
    )
    return _section("time", "Earthquake by earthquake", text, controls + _plot("traces", words))


def _sample(k: int) -> str:
    """Return a piece of the controller's line, as the figures draw it."""
    style = PLOTLY[k % len(PLOTLY)]
    dash = "" if style["dash"] == "solid" else f' stroke-dasharray="{style["dash"].replace("px", "")}"'
    return (
        '<svg width="34" height="10" aria-hidden="true"><line x1="1" y1="5" x2="33" y2="5" '
        f'stroke="{style["color"]}" stroke-width="2.4"{dash}/></svg>'
    )


def _spectra(report: Report, data: dict[str, Any]) -> str:
    one = _plot("spectrum", "Response spectra of target and achieved on the chosen earthquake.")
    text = (
        "Pseudo-acceleration at 5 % damping. The band is 10 % to either side of the target: an ordinate "
        "outside counts as missed. A test that a limit ended counts as far as it ran."
    )
    if not any(value is not None for row in data["ratios"] for value in row):
        return _section("spectra", "Response spectra", text, one)
    text += (
        " First the chosen earthquake, then achieved over target, geometric mean over the earthquakes "
        f"of the verdict ({report.verdict.group})."
    )
    other = _plot("ratio", "Achieved over target response spectrum, mean over earthquakes.")
    return _section("spectra", "Response spectra", text, f'<div class="pair">{one}{other}</div>')


def _transfer(data: dict[str, Any]) -> str:
    if data["transfer"] is None:
        return ""
    text = (
        "From the target acceleration to both errors, estimated from all tests (Welch, windows of 4 s). "
        "Where the acceleration error is 1 it is as large as the target: the table might as well stand "
        "still."
    )
    plots = _plot("transfer-acceleration", "Transfer function to the acceleration error.") + _plot(
        "transfer-shear", "Transfer function to the base shear error."
    )
    return _section("transfer", "Errors by frequency", text, f'<div class="pair">{plots}</div>')


def _hysteresis(data: dict[str, Any]) -> str:
    if not data["hysteresis"]:
        return ""
    text = (
        "Base shear against the drift of the first storey, in the stretch in view above: how the "
        "specimen yielded on the table, and how it would have on real ground (grey)."
    )
    words = "Hysteresis loops of the first storey, on the table and on real ground."
    return _section("loops", "How the specimen yielded", text, _plot("hysteresis", words))


def _robustness(report: Report, data: dict[str, Any]) -> str:
    found = data["robustness"]
    if found is None:
        return ""
    text = (
        "Each mark is an earthquake with its own plant, drawn and told to nobody. Larger and darker: "
        "a larger error of base shear (beyond the largest shown for 95 % of them, no larger)."
    )
    if len(found["parameters"]) > 2:
        others = ", ".join(each["label"] for each in found["parameters"][2:])
        text += f" Drawn as well, and not shown: {escape(others)}."
    words = "Base shear error against the drawn parameters of the plant, a map for each controller."
    return _section("robust", "Plants that nobody knew", text, _plot("robustness", words))


def _unlike(report: Report) -> str:
    if report.unlike is None:
        return ""
    result = report.unlike
    text = (
        "Every controller as it is on this scenario, on tables, loops and motions that it was not made "
        f"for: {len(result['earthquakes'])} earthquakes for each value. Where the reference lost a test "
        "its cost is no measure; the grey line is its own cost over what it is where nothing is changed."
    )
    return _section("unlike", "Where they were not made for it", text, robustness_part(result))


def _learning(report: Report, data: dict[str, Any]) -> str:
    if not report.policies:
        return ""
    head = "".join(
        f'<th scope="col">{each}</th>'
        for each in (
            "policy",
            "algorithm",
            "seed",
            "steps [million]",
            "training [min]",
            "own evaluation",
        )
    )
    lines = []
    for name, policy in report.policies.items():
        config, found = policy.card.get("config", {}), policy.card.get("evaluation", {})
        cells = (
            escape(str(config.get("algorithm", "–"))),  # noqa: RUF001
            escape(str(config.get("seed", "–"))),  # noqa: RUF001
            _number(float(found.get("steps", np.nan)) / 1e6, 2),
            _number(float(found.get("seconds", np.nan)) / 60, 1),
            _number(float(found.get("cost_ratio", np.nan)), 3),
        )
        tds = "".join(f"<td>{cell}</td>" for cell in cells)
        lines.append(f'<tr><th scope="row">{escape(report.labels[name])}</th>{tds}</tr>')
    table = (
        '<div class="scroll" tabindex="0" role="region" aria-label="Table: learned policies"><table>\n'
        "<caption>From the policies' own cards; the evaluation is the cost relative to the run's "
        f"reference on its own earthquakes.</caption>\n<thead><tr>{head}</tr></thead>\n"
        f"<tbody>{''.join(lines)}</tbody></table></div>\n"
    )
    text, plot = "How the policies among the controllers were made.", ""
    if data["learning"]:
        text += " Curves: evaluations during training; dashed: as good as the run's reference."
        plot = _plot("learning", "Cost relative to the reference over training.")
    return _section("learned", "Learned policies", text, plot + table)


def _footer(report: Report, stills: Sequence[str]) -> str:
    links = ", ".join(
        f'{escape(name.replace("_", " "))} (<a href="{name}.svg">SVG</a>, <a href="{name}.png">PNG</a>)'
        for name in stills
    )
    comparison = report.comparison
    lines = [
        f"<p>The figures as pictures: {links}.</p>",
        f"<p>Made by shake-env {escape(shake_env.__version__)}: "
        f"<code>{escape(report.command)}</code></p>",
        "<p>Curves over time are thinned to what one page holds, to a quarter of a percent of their "
        "peak; every number is from the full histories.</p>",
    ]
    for name, share in comparison.interventions.items():
        lines.append(
            f"<p>The supervisor changed {100 * share:.2f} % of the commands of "
            f"{escape(report.labels[name])}.</p>"
        )
    if comparison.skipped:
        lines.append(f"<p>Left out: {escape('; '.join(comparison.skipped))}.</p>")
    return "\n".join(lines)


def write_report(report: Report, folder: str | PathLike[str]) -> list[Path]:
    """Write ``index.html`` and every figure as SVG and PNG into a folder; return the paths."""
    folder = Path(folder)
    names = stills(report, folder)
    path = folder / "index.html"
    path.write_text(page(report, names), encoding="utf-8")
    return [path, *(folder / f"{name}.{ending}" for name in names for ending in ("svg", "png"))]


WORDS = (
    "Cost over the reference's with one thing changed at a time.",
    "Cost over the reference's with pairs of things changed.",
)


def robustness_part(result: dict[str, Any]) -> str:
    """Return pictures and sentences of a robustness result as HTML, the pictures within it."""
    pictures = "".join(
        f'<figure><img src="data:image/png;base64,{_png(figure)}" alt="{escape(words, quote=True)} '
        f'What it says stands below." style="max-width:100%;height:auto"></figure>\n'
        for figure, words in zip(figures(result).values(), WORDS, strict=False)
    )
    told = "".join(
        f"<li><strong>{escape(label(each))}</strong>: "
        f"{escape(' '.join(findings(result, each['name'])))}</li>\n"
        for each in result["controllers"]
        if each["name"] != result["reference"]
    )
    return f"{pictures}<ul>\n{told}</ul>\n"


def _png(figure: Figure) -> str:
    written = io.BytesIO()
    with figure_style():
        figure.savefig(written, format="png", metadata={"Software": None})
    return base64.b64encode(written.getvalue()).decode("ascii")
