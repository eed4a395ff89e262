"""Controllers on the same earthquakes: figures with intervals, as data. Printing is `compare_output`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap

import shake_env
from agents.policy_file import load_policy
from baselines.lqr import lqr
from shake_env.controller import Controller, NoControl
from shake_env.errors import ParameterError, PolicyFileError
from shake_env.metrics import EpisodeMetrics
from shake_env.rollout import Earthquake, noise_earthquakes, recorded_earthquakes, rollout
from shake_env.scenario import Scenario
from shake_env.trajectory import Trajectory

SHIPPED = "policy"  # name of the policy that comes with the package
FIGURES = (
    "acceleration_rms_error",
    "acceleration_peak_error",
    "base_shear_rms_error",
    "base_shear_peak_error",
)
PEAKS = ("peak_current", "peak_velocity", "peak_displacement")


@dataclass(frozen=True)
class GroupSummary:
    """One controller over one group of earthquakes."""

    controller: str
    group: str  # "motions", "records" or "filtered noise"
    earthquakes: int
    relative_cost: float  # summed cost over LQR's summed cost on the same earthquakes [-]
    relative_cost_low: float  # 95 % bootstrap interval over earthquakes, paired with LQR's
    relative_cost_high: float
    mean_cost: float
    acceleration_rms_error: float  # mean over earthquakes, relative to the target's rms [-]
    acceleration_peak_error: float
    base_shear_rms_error: float
    base_shear_peak_error: float
    peak_current: float  # largest over earthquakes [A]
    peak_velocity: float  # [m/s]
    peak_displacement: float  # [m]
    broken_limits: int  # episodes that a limit ended


@dataclass(frozen=True)
class Comparison:
    """All controllers on all earthquakes."""

    summaries: list[GroupSummary]
    episodes: dict[str, list[EpisodeMetrics]]  # by controller, in the order of the earthquakes
    traces: dict[str, Trajectory]  # by controller, on `traced`
    traced: str  # name of the earthquake that was traced
    skipped: list[str]  # what was left out, and why

    def to_json(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return everything but the traces as plain JSON values."""
        return {
            "version": shake_env.__version__,
            "settings": settings,
            "summaries": [asdict(summary) for summary in self.summaries],
            "episodes": {name: [asdict(m) for m in rows] for name, rows in self.episodes.items()},
            "traced": self.traced,
            "skipped": self.skipped,
        }


def shipped_policy() -> Path:
    """Return the policy file that comes with the package."""
    return Path(str(resources.files("agents") / "pretrained" / "linear-ppo.safetensors"))


def named_controllers(
    names: Sequence[str], scenario: Scenario
) -> tuple[dict[str, Controller], list[str]]:
    """Return controllers by name, and what had to be left out.

    Parameters
    ----------
    names
        ``lqr``, ``none``, ``policy`` (the shipped one) or paths of policy files and run directories.
        LQR is always among them: it is what cost is relative to.
    scenario
        What they drive. The shipped policy is left out where it does not fit; a named file raises.

    Raises
    ------
    PolicyFileError
        If a named policy cannot be read or does not fit the scenario.
    """
    controllers: dict[str, Controller] = {"lqr": lqr(scenario)}
    skipped = []
    for name in names:
        if name == "none":
            controllers["none"] = NoControl()
        elif name == SHIPPED:
            policy = load_policy(shipped_policy())
            try:
                policy.check(scenario)
                controllers[SHIPPED] = policy
            except PolicyFileError as error:
                skipped.append(f"the shipped policy ({error})")
        elif name != "lqr":
            path = Path(name)
            policy = load_policy(path / "policy.safetensors" if path.is_dir() else path)
            policy.check(scenario)
            controllers[name] = policy
    return controllers, skipped


def compare(
    scenario: Scenario,
    names: Sequence[str],
    *,
    noise: int = 32,
    records: bool = True,
    seed: int = 2_000_000,
    motions: Sequence[Earthquake] = (),
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> Comparison:
    """Run every controller on the same earthquakes.

    Parameters
    ----------
    scenario
        What is driven.
    names
        See :func:`named_controllers`.
    noise
        Number of seeded filtered-noise earthquakes.
    records
        Whether the embedded records are among the earthquakes.
    seed
        First seed of the noise; far from those of training and its evaluation.
    motions
        Further earthquakes, a group of their own; the first of them is traced.
    on_progress
        Told the controller that runs and its share done, 0 to 1.

    Raises
    ------
    ParameterError
        If no earthquake is asked for.
    """
    recorded = recorded_earthquakes(scenario) if records else []
    earthquakes = [*motions, *recorded, *noise_earthquakes(scenario, noise, seed)]
    if not earthquakes:
        raise ParameterError("noise", noise, "ask for at least one earthquake, or for the records")
    noisy = len(motions) + len(recorded)
    groups = {
        "motions": range(len(motions)),
        "records": range(len(motions), noisy),
        "filtered noise": range(noisy, len(earthquakes)),
    }
    traced = _strongest(recorded) if recorded and not motions else 0
    controllers, skipped = named_controllers(names, scenario)
    episodes: dict[str, list[EpisodeMetrics]] = {}
    traces: dict[str, Trajectory] = {}
    for name, controller in controllers.items():

        def told(share: float, name: str = name) -> None:
            on_progress(name, share)

        episodes[name], found = rollout(controller, scenario, earthquakes, record=[traced], on_step=told)
        traces[name] = found[traced]
    summaries = [
        summarise(name, group, [rows[i] for i in members], [episodes["lqr"][i] for i in members])
        for group, members in groups.items()
        if len(members)
        for name, rows in episodes.items()
    ]
    return Comparison(summaries, episodes, traces, earthquakes[traced].name, skipped)


def _strongest(recorded: Sequence[Earthquake]) -> int:
    names = [quake.name for quake in recorded]
    return names.index("ridgecrest2019_clc_360")


def summarise(
    name: str, group: str, rows: Sequence[EpisodeMetrics], reference: Sequence[EpisodeMetrics]
) -> GroupSummary:
    """Return one controller's figures over a group, its cost relative to `reference`'s, paired."""
    cost = np.asarray([row.cost for row in rows])
    base = np.asarray([row.cost for row in reference])
    low, high = _interval(cost, base)
    means = {figure: float(np.mean([getattr(row, figure) for row in rows])) for figure in FIGURES}
    peaks = {peak: float(np.max([getattr(row, peak) for row in rows])) for peak in PEAKS}
    return GroupSummary(
        controller=name,
        group=group,
        earthquakes=len(rows),
        relative_cost=_ratio(cost, base),
        relative_cost_low=low,
        relative_cost_high=high,
        mean_cost=float(cost.mean()),
        broken_limits=sum(row.broken_limit is not None for row in rows),
        **means,
        **peaks,
    )


def _ratio(cost: NDArray[np.float64], base: NDArray[np.float64], axis: int = -1) -> Any:
    return np.sum(cost, axis=axis) / np.sum(base, axis=axis)


def _interval(cost: NDArray[np.float64], base: NDArray[np.float64]) -> tuple[float, float]:
    """Return the 95 % percentile-bootstrap interval of the cost ratio over earthquakes."""
    if len(cost) < 2 or np.array_equal(cost, base):
        ratio = float(_ratio(cost, base))
        return ratio, ratio
    result = bootstrap(
        (cost, base), _ratio, paired=True, vectorized=True, method="percentile", n_resamples=9999,
        rng=np.random.default_rng(0),
    )  # fmt: skip
    return float(result.confidence_interval.low), float(result.confidence_interval.high)
