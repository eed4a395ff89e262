"""The U.S. Geological Survey's SMC: 11 lines of text, 48 integers, 50 reals, comments, ``8E10.4E1``.

Accelerations are in cm/s^2 by the format. The first integer and the first real are those that stand for
"unknown". Format: Converse and Brady, BAP, USGS Open-File Report 92-296A.
"""

from __future__ import annotations

import numpy as np

from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.header import (
    LONGEST_LINE,
    check_peak,
    check_peak_about_any_mean,
    lower_line,
    sensor_entries,
    words_after,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_TEXTS, _INTEGERS, _REALS = 11, 48, 50
_FASTEST = 1e5  # Hz; some files hold nonsense above it
_KINDS = {
    "1 uncorrected accelerogram": "1, uncorrected",
    "2 corrected accelerogram": "2, corrected",
}
_OTHERS = ("3 velocity", "4 displacement", "5 response spectra", "6 fourier")
_SEISMOMETERS = (134, 135, 136, 137, 138, 139)  # codes of sensors that measure velocity


def is_smc(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    first = data[:200].split(b"\n")[0].strip().lower().decode("latin-1")
    return first.startswith((*_KINDS, *_OTHERS)) and b"\n*" in data[:400]


def parse_smc(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read an SMC file: one record.

    Raises
    ------
    RecordError
        If the file holds no acceleration, or counts or peaks in its header are not the data's.
    """
    source = SourceText(name, data)
    kind = _KINDS.get(" ".join(lower_line(source, 0).split()))
    if kind is None:
        raise source.error(0, "the file holds no acceleration: give the accelerogram")
    integers = source.fields(_TEXTS, _INTEGERS, 8, 10, "I").astype(np.int64)
    reals_at = _TEXTS + _INTEGERS // 8
    reals = source.fields(reals_at, _REALS, 5, 15, "E")
    unknown = int(integers[0])
    remarks, points = (int(integers[i]) if integers[i] != unknown else 0 for i in (15, 16))
    first = reals_at + _REALS // 5
    counts_at = _TEXTS + 2
    if points < 2:
        raise source.error(counts_at, "the number of points must be 2 at least", f"{points} points")
    for index in range(first, first + max(remarks, 0)):
        if not source.line(index).startswith("|"):
            raise source.error(
                counts_at - 1, f"line {index + 1} is no comment, which begins with '|'", remarks
            )
    first += max(remarks, 0)
    rate = float(reals[1])
    known = reals[1] != reals[0] and 0.0 < rate <= _FASTEST
    step = settle_interval(source.place(reals_at), 1.0 / rate if known else None, sampling_interval)
    unit = settle_unit(source.place(0), "cm/s^2", units)
    acceleration = unit.to_si(source.fields(first, points, 8, 10, "E"))
    end = first + -(-points // 8)
    if end < len(source):
        raise source.error(end, f"is more than {points} points", source.line(end).strip()[:40])
    _check_peaks(source, reals_at, reals, unit, acceleration)
    component = " ".join(words_after(source.line(5)[:LONGEST_LINE], "component"))
    attribution = (
        ("format", f"SMC, {kind}"),
        ("component", component or "not stated"),
        *_texts(source, first - max(remarks, 0), first),
        *sensor_entries(component if len(component) == 3 and component.isalpha() else ""),
        *((("sensor", f"a seismometer, type {integers[14]}"),) if integers[14] in _SEISMOMETERS else ()),
        *((("problem flag", "set: see the header's comments"),) if integers[17] == 1 else ()),
        ("units in the file", str(unit)),
    )
    return (Record(name, acceleration, step, attribution),)


def _check_peaks(
    source: SourceText, reals_at: int, reals: FloatArray, unit: Unit, acceleration: FloatArray
) -> None:
    """Compare the data with the header's largest and smallest value, and with its text's peak."""
    largest, smallest = float(reals[29]), float(reals[31])
    if float(reals[0]) not in (largest, smallest) and (largest, smallest) != (0.0, 0.0):
        stated = f"{max(abs(largest), abs(smallest)):.7f}"
        check_peak(source.place(reals_at + 5), stated, unit, acceleration)
    for phrase in (("pk", "acc"), ("pk",)):
        words = words_after(source.line(6)[:LONGEST_LINE], *phrase)
        if words and parse_number(words[0]) is not None and float(words[0]) > 0.0:
            check_peak_about_any_mean(source.place(6), words[0], unit, acceleration)


def _texts(source: SourceText, first: int, last: int) -> list[tuple[str, str]]:
    lines = [*range(_TEXTS), *range(first, last)]
    texts = [(i, source.line(i).strip(" *|\t")) for i in lines]
    return [(f"header line {i + 1}", text) for i, text in texts if text]
