"""The part of a report on tables that its controllers were not made for, from a robustness result."""

from __future__ import annotations

import base64
import io
from html import escape
from typing import Any

from matplotlib.figure import Figure

from agents.figure_style import figure_style
from agents.robustness_figure import figures
from agents.robustness_output import findings, label

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
