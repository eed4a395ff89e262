"""A comparison as pandas frames, and what each of their columns means."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import shake_env
from agents.evaluation.bound_store import Bounds
from agents.evaluation.controller_set import describe_values, values_to_json
from agents.evaluation.fidelity import Fidelity
from agents.evaluation.scores import below_bound
from agents.evaluation.tracking import BANDS, TrackingFigures
from agents.plain_values import plain_row
from baselines.registry import ParameterValues
from shake_env.errors import ParameterError
from shake_env.simulation.metrics import EpisodeMetrics
from shake_env.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from pandas import DataFrame

Rows = Literal["episodes", "summaries", "traces"]


@dataclass(frozen=True)
class Column:
    """A column's unit and meaning; a unit of ``-`` is a ratio, of ``""`` no number."""

    unit: str
    meaning: str


COLUMNS: dict[str, Column] = {
    "controller": Column("", "name of the controller"),
    "group": Column("", "motions, records or filtered noise"),
    "information": Column("", "what the controller knows of the motion"),
    "earthquake": Column("", "name of the earthquake"),
    "earthquakes": Column("1", "number of earthquakes in the group"),
    "cost": Column("-", "mean stage cost over the motion, a broken limit's included"),
    "relative_cost": Column("-", "summed cost over the reference's on the same earthquakes"),
    "relative_cost_low": Column("-", "lower end of its 95 % bootstrap interval"),
    "relative_cost_high": Column("-", "upper end of it"),
    "bound_cost": Column("-", "summed cost over the true bound's; NaN where no bound was asked for"),
    "bound_cost_low": Column("-", "lower end of its 95 % bootstrap interval"),
    "bound_cost_high": Column("-", "upper end of it"),
    "regret_closed": Column("-", "share of the reference's cost above the bound that is saved"),
    "mean_cost": Column("-", "mean over earthquakes of the mean stage cost"),
    "acceleration_rms_error": Column("-", "rms of y_A - y~ over the target's rms"),
    "acceleration_peak_error": Column("-", "peak of abs(y_A - y~) over the target's peak"),
    "base_shear_rms_error": Column("-", "rms of f_s - f~_s over the reference's rms"),
    "base_shear_peak_error": Column("-", "peak of abs(f_s - f~_s) over the reference's peak"),
    "peak_current": Column("A", "largest valve current; of a table driven in volts its input [V]"),
    "peak_velocity": Column("m/s", "largest table velocity"),
    "peak_displacement": Column("m", "largest table displacement"),
    "broken_limit": Column("", "what ended the episode early; None where nothing did"),
    "broken_limits": Column("1", "number of earthquakes that a limit ended"),
    "delay": Column("s", "lag of the table's acceleration behind the target's"),
    "spectral_error": Column("-", "share of response-spectrum ordinates more than 10 % off"),
    "arias_ratio": Column("-", "Arias intensity over the target's"),
    "drift_ratio": Column("-", "peak first-storey drift over the reference specimen's"),
    "energy_ratio": Column("-", "energy dissipated in the first storey over the reference specimen's"),
    "decision_time": Column("s", "processor time of one decision for one table, median"),
    "tests": Column("1", "tests of each earthquake, the one that counts included"),
    "damage": Column("-", "energy of the tests before it over one perfect test's, median"),
    "time": Column("s", "after each physics step"),
    "target_acceleration": Column("m/s^2", "y~, what the table should do"),
    "table_acceleration": Column("m/s^2", "y_A, what it did"),
    "reference_base_shear": Column("N", "f~_s, of the specimen on real ground"),
    "base_shear": Column("N", "f_s, of the specimen on the table"),
}


def to_frame(comparison: Comparison, rows: Rows = "episodes") -> DataFrame:
    """Return a comparison as a frame; ``frame.attrs["units"]`` holds the unit of each column.

    Parameters
    ----------
    comparison
        What `agents.evaluation.comparison.compare` returned.
    rows
        ``"episodes"``: one row a controller and earthquake. ``"summaries"``: one a controller and group.
        ``"traces"``: one a controller and physics step of the traced earthquake.

    Raises
    ------
    ParameterError
        If `rows` is another word.
    """
    import pandas  # half a second that the command line need not spend

    records: list[dict[str, Any]]
    if rows == "episodes":
        records = [
            {"controller": name, **asdict(metrics), **asdict(measures)}
            for name, episodes in comparison.episodes.items()
            for metrics, measures in zip(episodes, comparison.fidelities[name], strict=True)
        ]
        frame = pandas.DataFrame.from_records(records)
    elif rows == "summaries":
        frame = pandas.DataFrame.from_records([asdict(s) for s in comparison.summaries])
    elif rows == "traces":
        signals = [name for name in COLUMNS if name.endswith(("acceleration", "base_shear"))]
        parts = [
            pandas.DataFrame(
                {"controller": name, "time": trace.time, **{s: getattr(trace, s) for s in signals}}
            )
            for name, trace in comparison.traces.items()
        ]
        frame = pandas.concat(parts, ignore_index=True)
    else:
        raise ParameterError("rows", rows, "known: episodes, summaries, traces")
    units = {str(name): COLUMNS[str(name)].unit for name in frame.columns}
    if "peak_current" in units:
        units["peak_current"] = comparison.input_unit
    frame.attrs["units"] = units
    return frame


def drive_column(input_unit: str) -> tuple[str, str, float]:
    """Return what a table's input is called, its unit in tables, and how many of it the SI unit has."""
    return ("current", "mA", 1e3) if input_unit == "A" else ("input", input_unit, 1.0)


@dataclass(frozen=True)
class GroupSummary:
    """One controller over one group of earthquakes."""

    controller: str
    group: str  # "motions", "records" or "filtered noise"
    earthquakes: int
    relative_cost: float  # summed cost over the reference's summed cost on the same earthquakes [-]
    relative_cost_low: float  # 95 % bootstrap interval over earthquakes, paired; NaN: of one earthquake
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
    delay: float  # means over earthquakes of `fidelity.Fidelity`; [s]
    spectral_error: float
    arias_ratio: float
    drift_ratio: float
    energy_ratio: float
    decision_time: float  # [s] of the processor, median of one decision for one table; NaN: prepared
    tests: int  # of each earthquake that it takes, the one that counts included
    damage: float  # median energy of the tests before that over one perfect test's [-]; NaN: none
    information: str = "-"  # class of what it knows of the motion, see `baselines.information`
    bound_cost: float = float("nan")  # summed cost over the true bound's [-]; NaN: not asked for
    bound_cost_low: float = float("nan")
    bound_cost_high: float = float("nan")
    regret_closed: float = float("nan")  # share of the reference's cost above the bound that is saved

    def cost_text(self) -> str:
        """Return the relative cost with its interval; of one earthquake without."""
        return cost_text(self.relative_cost, self.relative_cost_low, self.relative_cost_high)


@dataclass(frozen=True)
class Comparison:
    """All controllers on all earthquakes."""

    summaries: list[GroupSummary]
    episodes: dict[str, list[EpisodeMetrics]]  # by controller, in the order of the earthquakes
    fidelities: dict[str, list[Fidelity]]  # likewise
    traces: dict[str, Trajectory]  # by controller, on `traced`
    reference: str  # controller that costs are relative to
    traced: str  # name of the earthquake that was traced
    skipped: list[str]  # what was left out, and why
    interventions: dict[str, float]  # by controller: share of commands that a supervisor changed
    groups: list[str]  # of each earthquake, in their order
    values: dict[str, ParameterValues] = field(default_factory=dict)  # by controller, with their source
    warnings: list[str] = field(default_factory=list)  # policies far from what they were trained on
    tracking: dict[str, list[TrackingFigures]] = field(default_factory=dict)  # as `fidelities`
    bounds: Bounds | None = None  # true bound of each earthquake, in their order; None: not asked for
    information: str = "causal"  # class of what the scenario shows
    input_unit: str = "A"  # of the table's input
    events: tuple[str, ...] = ()  # of each motion of a named set, in their order; see `by_event`

    def to_json(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return everything but the traces as plain JSON values."""
        return {
            "version": shake_env.__version__,
            "settings": settings,
            "summaries": [plain_row(asdict(summary)) for summary in self.summaries],
            "episodes": {
                name: [
                    plain_row(asdict(m) | asdict(f))
                    for m, f in zip(rows, self.fidelities[name], strict=True)
                ]
                for name, rows in self.episodes.items()
            },
            "tracking": {
                "bands": BANDS,
                "controllers": {
                    name: [figures.to_json() for figures in rows] for name, rows in self.tracking.items()
                },
            },
            "reference": self.reference,
            "traced": self.traced,
            "skipped": self.skipped,
            "interventions": self.interventions,
            "values": values_to_json(self.values),
            "warnings": self.warnings,
            "bound": self.bound_to_json(),
            "information": self.information,
            "by_event": self.by_event(),
        }

    def bound_to_json(self) -> dict[str, Any] | None:
        """Return the bounds with ``below``, the episodes that cost less; None: not asked for."""
        if self.bounds is None:
            return None
        bound = self.bounds.to_json()
        if not bound["reason"]:
            bound["below"] = [
                {"controller": name, **each}
                for name, rows in self.episodes.items()
                for each in below_bound([[m.cost for m in rows]], bound["costs"], bound["disagreements"])
            ]
        return bound

    def by_event(self) -> dict[str, dict[str, float]]:
        """Return the cost over the reference's by event and controller; {}: there are no events."""
        costs = {}
        for event in dict.fromkeys(self.events):
            members = [i for i, each in enumerate(self.events) if each == event]
            sums = {n: sum(rows[i].cost for i in members) for n, rows in self.episodes.items()}
            costs[event] = {name: cost / sums[self.reference] for name, cost in sums.items()}
        return costs

    def notes(self) -> list[str]:
        """Return what a reader has to know of the controllers, in sentences."""
        values = describe_values(values_to_json(self.values))
        return ([values] if values else []) + [f"Warning: {text}." for text in self.warnings]

    def to_frame(self, rows: Rows = "episodes") -> DataFrame:
        """Return episodes, summaries or traces as a pandas frame; see `agents.evaluation.results`."""
        return to_frame(self, rows)


def cost_text(value: float, low: float | None, high: float | None) -> str:
    """Return a cost with its interval in words, without one where there is none."""
    known = low is not None and high is not None and low == low
    digits = 3 if (high if known and high is not None else value) < 10.0 else 1
    return f"{value:.{digits}f}" + (f" [{low:.{digits}f}, {high:.{digits}f}]" if known else "")
