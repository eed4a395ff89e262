"""A comparison as pandas frames, and what each of their columns means."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any, Literal

from shake_env.errors import ParameterError

if TYPE_CHECKING:
    from pandas import DataFrame

    from agents.compare import Comparison

Rows = Literal["episodes", "summaries", "traces"]


@dataclass(frozen=True)
class Column:
    """A column's unit and meaning; a unit of ``-`` is a ratio, of ``""`` no number."""

    unit: str
    meaning: str


COLUMNS: dict[str, Column] = {
    "controller": Column("", "name of the controller"),
    "group": Column("", "motions, records or filtered noise"),
    "earthquake": Column("", "name of the earthquake"),
    "earthquakes": Column("1", "number of earthquakes in the group"),
    "cost": Column("-", "mean stage cost over the motion, a broken limit's included"),
    "relative_cost": Column("-", "summed cost over the reference's on the same earthquakes"),
    "relative_cost_low": Column("-", "lower end of its 95 % bootstrap interval"),
    "relative_cost_high": Column("-", "upper end of it"),
    "mean_cost": Column("-", "mean over earthquakes of the mean stage cost"),
    "acceleration_rms_error": Column("-", "rms of y_A - y~ over the target's rms"),
    "acceleration_peak_error": Column("-", "peak of abs(y_A - y~) over the target's peak"),
    "base_shear_rms_error": Column("-", "rms of f_s - f~_s over the reference's rms"),
    "base_shear_peak_error": Column("-", "peak of abs(f_s - f~_s) over the reference's peak"),
    "peak_current": Column("A", "largest valve current"),
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
        What `agents.compare.compare` returned.
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
    frame.attrs["units"] = {str(name): COLUMNS[str(name)].unit for name in frame.columns}
    return frame
