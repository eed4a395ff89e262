"""What a rehearsal leaves: the log of its test, its periods one by one, and a figure of its times."""

from __future__ import annotations

import csv
import io
import os
from pathlib import Path

import numpy as np

from agents.deployment.rehearsal.rehearsed import Rehearsal
from agents.laboratory.logs.test_log import LEAST, TestLog, text_of_scenario
from shake_env.files import write_text
from shake_env.scenario.digest import scenario_digest


def recorded_log(test: Rehearsal, name: str) -> TestLog | None:
    """Return a test as a laboratory's recorder would have logged it; None where it was too short."""
    if len(test.samples) < LEAST:
        return None
    columns = np.array(test.samples, dtype=np.float64).T
    return TestLog(
        name=name,
        sampling_interval=test.scenario.control_period,
        channels={
            channel: np.ascontiguousarray(column)
            for channel, column in zip(test.channels, columns, strict=True)
        },
        scenario_text=text_of_scenario(test.scenario),
        digest=scenario_digest(test.scenario),
        source="rehearsal",
        input_unit=test.scenario.input_unit,
    )


def write_periods(test: Rehearsal, path: str | os.PathLike[str]) -> Path:
    """Write a test's control periods as CSV: names with units, then one row each; return the file.

    Times, modes, events and faults, which a log of a test has no channels for.
    """
    path = Path(path)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(test.columns)
    for row in test.rows:
        writer.writerow([f"{value:.9g}" if isinstance(value, float) else value for value in row])
    write_text(path, text.getvalue())
    return path


def draw_timing(test: Rehearsal, path: str | os.PathLike[str], deadline: float) -> Path:
    """Draw the distributions of latency and jitter; return the file.

    Parameters
    ----------
    test
        What was measured.
    path
        Of the picture.
    deadline
        [s] of a command.
    """
    path = Path(path)
    from agents.figure_style import figure_style, new_figure, write_figure

    latency = test.column("latency")
    jitter = np.abs(test.column("jitter"))
    with figure_style():
        figure = new_figure(8.0, 3.2)
        panels = figure.subplots(1, 2, sharey=True)
        for panel, values, name in (
            (panels[0], latency[np.isfinite(latency)], "latency of a command [µs]"),
            (panels[1], jitter, "jitter of a period's start [µs]"),
        ):
            if len(values):
                low = max(float(values.min()), 0.1)
                bins = np.geomspace(low, max(float(values.max()), 2.0 * low), 60)
                panel.hist(np.maximum(values, low), bins=bins)
            panel.set(xscale="log", yscale="log", xlabel=name)
        panels[0].axvline(1e6 * deadline, color="black", linestyle="--", label="deadline")
        panels[0].legend()
        panels[0].set_ylabel("control periods")
        write_figure(figure, path)
    return path
