"""What the optimum of an episode does: motion, base shear, current."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.results import drive_column
from agents.figure_style import CONTROLLERS, TARGET, figure_style, new_figure, save_figure
from baselines.planning.bound import OptimalEpisode
from shake_env.model.parameters import FloatArray


def draw_optimum(optimum: OptimalEpisode, folder: str | PathLike[str]) -> list[Path]:
    """Draw an episode's target, what the best currents make of it, and these; return the files."""
    episode = optimum.episode
    return draw_plan(
        f"{episode.earthquake.name}: stage cost {optimum.cost:.4g}",
        (episode.target, episode.shear),
        optimum.response,
        optimum.current,
        (episode.model.scenario.physics_step, episode.model.scenario.control_period),
        folder,
        "optimum",
        episode.model.scenario.input_unit,
    )


def draw_plan(
    title: str,
    wanted: tuple[FloatArray, FloatArray],
    response: FloatArray,
    current: FloatArray,
    steps: tuple[float, float],
    folder: str | PathLike[str],
    name: str,
    input_unit: str,
) -> list[Path]:
    """Draw a plan and return the paths written.

    Parameters
    ----------
    wanted
        (T, k) target acceleration [m/s^2] and reference base shear [N].
    response
        (T, 2 k) acceleration after each physics step, then base shear.
    current
        (T) [A], or in the `input_unit` of the table.
    steps
        Physics step and control period [s].
    """
    with figure_style():
        figure = new_figure(7.0, 6.0)
        axes = figure.subplots(3, 1, sharex=True)
        _draw(axes, wanted, response, current, steps, drive_column(input_unit))
        axes[0].set_title(title)
        Path(folder).mkdir(parents=True, exist_ok=True)
        return save_figure(figure, folder, name)


def _draw(
    axes: Any,
    wanted: tuple[FloatArray, FloatArray],
    response: FloatArray,
    current: FloatArray,
    steps: tuple[float, float],
    drive: tuple[str, str, float],
) -> None:
    k = wanted[0].shape[1]
    fine = steps[0] * np.arange(1, wanted[0].size + 1)
    line = {key: CONTROLLERS[0][key] for key in ("color", "linestyle")}
    for axis, goal, done, factor, label in (
        (axes[0], wanted[0], response[:, :k], 1.0, "acceleration [m/s²]"),
        (axes[1], wanted[1], response[:, k:], 1e-3, "base shear [kN]"),
    ):
        axis.plot(fine, factor * goal.ravel(), label="wanted", **TARGET)
        axis.plot(fine, factor * done.ravel(), label="planned", **line)
        axis.set_ylabel(label)
    axes[0].legend(ncols=2)
    name, unit, factor = drive
    axes[2].step(steps[1] * np.arange(len(current)), factor * current, where="post", color=line["color"])
    axes[2].set_ylabel(f"{name} [{unit}]")
    axes[2].set_xlabel("time [s]")
