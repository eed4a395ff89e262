"""A report as one HTML page that needs nothing beside it: text, tables, data, plotting library.

The template is ``assets/report.html``; ``assets/report.js`` draws the interactive figures.
"""

from __future__ import annotations

import base64
import io
import zlib
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, Undefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

import shake_env
from agents.evaluation.results import GroupSummary, drive_column
from agents.evaluation.statistics import mean_interval
from agents.figure_style import figure_style
from agents.policies.registry import ORACLE
from agents.reporting.bound_notes import comparison_notes, marked_class
from agents.reporting.report.acceptance import acceptance_section
from agents.reporting.report.contents import Report
from agents.reporting.report.data import page_data
from agents.reporting.report.figures import draw_report_figures
from agents.reporting.report.tracking import TRACKING_COLUMNS, tracking_rows
from agents.reporting.robustness_figures import robustness_figures
from agents.reporting.robustness_tables import controller_label, robustness_findings
from agents.reporting.summary_text import QUESTIONS
from shake_env.files import write_text

ROBUSTNESS_FIGURES = (
    "Cost over the reference's with one thing changed at a time.",
    "Cost over the reference's with pairs of things changed.",
)


def report_page(report: Report, stills: Sequence[str]) -> str:
    """Return the HTML page of a report.

    Parameters
    ----------
    report
        What is shown.
    stills
        Names of the figures that lie beside the page, without their endings.
    """
    from plotly.offline import get_plotlyjs  # a tenth of a second that other commands need not spend

    comparison = report.comparison
    groups: dict[str, list[int]] = {}
    for i, group in enumerate(comparison.groups):
        groups.setdefault(group, []).append(i)

    def error(row: GroupSummary, field: str) -> tuple[float, float, float]:
        """Return the mean error [%] of a row over its earthquakes, with its 95 % interval."""
        episodes = comparison.episodes[row.controller]
        value, low, high = mean_interval(
            np.array([getattr(episodes[i], field) for i in groups[row.group]])
        )
        return 100 * value, 100 * low, 100 * high

    environment = _environment()
    assert environment.loader is not None
    script, style = (
        Markup(environment.loader.get_source(environment, name)[0])  # own files
        for name in ("report.js", "report.css")
    )
    return environment.get_template("report.html").render(
        report=report,
        comparison=comparison,
        groups=groups,
        error=error,
        tracking_columns=TRACKING_COLUMNS,
        tracking=tracking_rows(comparison.tracking, groups[report.verdict.group]),
        data=page_data(report),
        setting=_setting(report),
        accepted=acceptance_section(report),
        changed=None if report.robustness is None else _robustness(report.robustness),
        stills=stills,
        oracle=ORACLE,
        questions=QUESTIONS,
        drive=drive_column(report.scenario.input_unit),
        notes=comparison_notes(comparison),
        version=shake_env.__version__,
        script=script,
        style=style,
        plotly=base64.b64encode(zlib.compress(get_plotlyjs().encode("utf-8"), 9)).decode("ascii"),
    )


def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader("agents.reporting", "assets"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    environment.filters.update(
        number=_number,
        picture=_png,
        interval=_interval,
        unbroken=unbroken_percentages,
        marked=marked_class,
    )
    environment.tests["finite"] = _finite
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    return environment


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


def unbroken_percentages(sentence: str) -> Markup:
    """Return a sentence as HTML whose numbers keep their percent signs on their line."""
    return escape(sentence).replace(" %", Markup("&nbsp;%"))


def _finite(value: Any) -> bool:
    return value is not None and not isinstance(value, Undefined) and bool(np.isfinite(value))


def _number(value: Any, digits: int, scale: float = 1.0) -> str:
    # Adding zero after rounding turns -0.0 into 0.0.
    return f"{round(scale * value, digits) + 0.0:.{digits}f}" if _finite(value) else "–"  # noqa: RUF001


def _interval(ends: tuple[float, float, float]) -> Markup:
    value, low, high = ends
    most = high if np.isfinite(high) else value
    digits = 3 if most < 1.0 else 2 if most < 10.0 else 1 if most < 1000.0 else 0
    # One earthquake has no interval.
    inside = f"[{low:.{digits}f}, {high:.{digits}f}]" if low < high else ""
    return Markup('{}<span class="interval">{}</span>').format(f"{value:.{digits}f}", inside)


def _robustness(result: dict[str, Any]) -> dict[str, Any]:
    """Return the pictures of a robustness result, and what it says of each controller."""
    pictures = zip(ROBUSTNESS_FIGURES, map(_png, robustness_figures(result).values()), strict=False)
    others = [each for each in result["controllers"] if each["name"] != result["reference"]]
    return {
        "pictures": list(pictures),
        "findings": [
            (controller_label(each), robustness_findings(result, each["name"])) for each in others
        ],
    }


def _png(figure: Figure) -> str:
    image = io.BytesIO()
    with figure_style():
        figure.savefig(image, format="png", metadata={"Software": None})
    return base64.b64encode(image.getvalue()).decode("ascii")


def write_report(report: Report, folder: str | PathLike[str]) -> list[Path]:
    """Write a report: ``index.html`` and every figure as SVG and PNG into a folder; return the paths."""
    folder = Path(folder)
    names = draw_report_figures(report, folder)
    path = folder / "index.html"
    write_text(path, report_page(report, names))
    return [path, *(folder / f"{name}.{ending}" for name in names for ending in ("svg", "png"))]
