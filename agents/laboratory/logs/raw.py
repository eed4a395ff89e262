"""What a file of a log holds before it is a log: named columns with units, and attributes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from agents.laboratory.logs.mapping import ChannelSource, Mapped
from agents.laboratory.logs.test_log import CURRENT, TestLog, unit_of
from shake_env.errors import LogError, ShakeError
from shake_env.model.parameters import FloatArray
from shake_env.scenario.quantities import QuantityError, to_si

FORMAT, VERSION = "shake_env log", 1
EVEN = 1e-3  # of a step: the most by which a time may be off its place

Attributes = Mapping[str, str | float]


@dataclass(frozen=True)
class RawTable:
    """Columns of a file."""

    source: str  # file and format, for messages
    columns: Mapping[str, FloatArray]  # (samples,) each
    units: Mapping[str, str] = field(default_factory=dict)  # of a column, as the file states it
    attributes: Attributes = field(default_factory=dict)

    def own(self) -> bool:
        """Return whether this program wrote the file."""
        return self.attributes.get("format") == FORMAT


def attributes_of(log: TestLog) -> dict[str, str | float]:
    """Return what a file of a log states beside its columns."""
    stated: dict[str, str | float] = {
        "format": FORMAT,
        "version": VERSION,
        "name": log.name,
        "sampling_interval": log.sampling_interval,
        "input_unit": log.input_unit,
        "sha256": log.sha256,
    }
    if log.scenario_text is not None:
        stated["scenario"] = log.scenario_text
    if log.digest is not None:
        stated["digest"] = log.digest
    return stated


def column_unit(log: TestLog, channel: str) -> str:
    """Return the unit in which a channel of a log is written."""
    return log.input_unit if channel == CURRENT else unit_of(channel)


def assemble_log(raw: RawTable, name: str, mapping: Mapped | None) -> TestLog:
    """Return the log that columns are.

    Parameters
    ----------
    raw
        Of the file.
    name
        Of the log, where the file states none.
    mapping
        What the columns of a foreign file are; None: those of a log that this program wrote.

    Raises
    ------
    LogError
        If a column is missing, a unit does not convert, times are uneven, or the data are not those of
        their digest.
    """
    if raw.own() and mapping is None:
        return _own(raw, name)
    if mapping is None:
        shown = ", ".join(map(repr, list(raw.columns)[:12]))
        raise LogError(
            raw.source, shown, "is no log of this program: name its columns in a mapping file"
        )
    channels = {
        channel: _converted(raw, source, channel, mapping.input_unit)
        for channel, source in mapping.channels.items()
    }
    return TestLog(
        name=name,
        sampling_interval=_step(raw, mapping),
        channels=channels,
        source=raw.source,
        input_unit=mapping.input_unit,
    )


def _own(raw: RawTable, name: str) -> TestLog:
    stated = raw.attributes
    if stated.get("version") != VERSION:
        raise LogError(f"{raw.source}, version", stated.get("version"), f"must be {VERSION}")

    def text(key: str) -> str | None:
        value = stated.get(key)
        if value is not None and not isinstance(value, str):
            raise LogError(f"{raw.source}, {key}", value, "must be a text")
        return value

    step = stated.get("sampling_interval")
    if not isinstance(step, float):
        raise LogError(f"{raw.source}, sampling_interval", step, "must be a number of seconds")
    log = TestLog(
        name=text("name") or name,
        sampling_interval=step,
        channels=dict(raw.columns),
        scenario_text=text("scenario"),
        digest=text("digest"),
        source=raw.source,
        input_unit=text("input_unit") or "A",
    )
    for channel in log.channels:
        unit = raw.units.get(channel)
        if unit != column_unit(log, channel):
            raise LogError(
                f"{raw.source}, unit of {channel}", unit, f"must be {column_unit(log, channel)}"
            )
    if text("sha256") != log.sha256:
        raise LogError(
            f"{raw.source}, sha256",
            text("sha256"),
            "is not that of the data: the file was damaged or edited",
        )
    return log


def _converted(raw: RawTable, source: ChannelSource, channel: str, input_unit: str) -> FloatArray:
    """Return a foreign column in SI."""
    values = _column(raw, source.column)
    unit = source.unit or raw.units.get(source.column)
    wanted = input_unit if channel == CURRENT else unit_of(channel)
    if unit is None:
        remedy = f"the file states no unit: give unit = '{wanted}' or another one in the mapping"
        raise LogError(f"{raw.source}, {source.column}", None, remedy)
    try:
        factor = to_si(f"1 {unit}", wanted)
    except QuantityError as error:
        raise LogError(f"{raw.source}, unit of {source.column}", unit, str(error)) from None
    converted: FloatArray = source.factor * factor * values + source.offset
    return converted


def _column(raw: RawTable, title: str) -> FloatArray:
    if title not in raw.columns:
        known = ", ".join(map(repr, list(raw.columns)[:20]))
        raise LogError(f"{raw.source}, column", title, f"is not in the file, which holds {known}")
    return raw.columns[title]


def _step(raw: RawTable, mapping: Mapped) -> float:
    """Return the step [s] of a foreign file: that of its times, or the one that the mapping states."""
    if mapping.time is None:
        step = mapping.sampling_interval or raw.attributes.get("sampling_interval")
        if not isinstance(step, float):
            remedy = "the file states no step: give sampling_interval or a time column in the mapping"
            raise LogError(raw.source, None, remedy)
        return step
    times = _column(raw, mapping.time.column)
    unit = mapping.time.unit or raw.units.get(mapping.time.column) or "s"
    try:
        times = times * to_si(f"1 {unit}", "s")
    except QuantityError as error:
        raise LogError(f"{raw.source}, unit of {mapping.time.column}", unit, str(error)) from None
    step = _even_step(times, f"{raw.source}, {mapping.time.column}")
    stated = mapping.sampling_interval
    if stated is not None and not math.isclose(step, stated, rel_tol=1e-4):
        raise LogError(f"{raw.source}, sampling_interval", stated, f"the times are {step:.6g} s apart")
    return stated or step


def _even_step(times: FloatArray, place: str) -> float:
    """Return the step of times (samples,) [s]."""
    if len(times) < 2 or not np.isfinite(times).all():
        raise LogError(place, len(times), "must hold finite times, two at least")
    steps = np.diff(times)
    step = float(np.median(steps))
    if not step > 0.0:
        raise LogError(place, step, "the times must rise")
    # A gap or a repeated sample, not the rounding of printed times.
    wrong = np.flatnonzero(np.abs(steps - step) > 0.5 * step)
    if len(wrong):
        at = int(wrong[0])
        remedy = (
            f"the step after sample {at + 1} is {steps[at]:.6g} s, elsewhere {step:.6g} s: fill the gap"
        )
        raise LogError(place, float(times[at]), remedy)
    mean = float(times[-1] - times[0]) / (len(times) - 1)
    off = np.abs(times - times[0] - mean * np.arange(len(times)))
    if off.max() > max(EVEN, 0.5 * _rounding(times) / mean) * mean + 1e-12:
        at = int(np.argmax(off))
        remedy = f"is {off[at]:.3g} s off the even steps of {mean:.6g} s: resample the log"
        raise LogError(f"{place}, sample {at + 1}", float(times[at]), remedy)
    return mean


def _rounding(times: FloatArray) -> float:
    """Return the last decimal place [s] in which printed times differ."""
    for places in range(1, 9):
        if np.allclose(times, np.round(times, places), rtol=0.0, atol=1e-12):
            return float(10.0**-places)
    return 0.0


def text_value(value: Any) -> str | float:
    """Return an attribute of a file as a text or a number."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, str):
        return value
    try:
        return float(value)
    except (TypeError, ValueError):
        return str(value)[:200]


def typed(error: Exception, source: str, remedy: str) -> ShakeError:
    """Return what a library raised on a damaged file as a LogError."""
    if isinstance(error, ShakeError):
        return error
    return LogError(source, f"{type(error).__name__}: {error}"[:200], remedy)
