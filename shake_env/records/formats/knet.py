"""K-NET and KiK-net ASCII: 17 lines of header, then counts, eight a line, times the scale factor.

The header's columns are 18 characters wide; its maximum is taken about the record's mean (NIED).
"""

from __future__ import annotations

import math
import re

import numpy as np

from shake_env.records.record import Record
from shake_env.records.text.header import check_peak
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, unit_named

_HEADER_LINES = 24  # at most
_KEY = 18  # characters
_SCALE = re.compile(
    r"(\d++(?:\.\d*+)?+)\s*+\((gal)\)\s*+/\s*+(\d++(?:\.\d*+)?+)", re.IGNORECASE | re.ASCII
)
_RATE = re.compile(r"(\d++(?:\.\d*+)?+)\s*+Hz", re.IGNORECASE | re.ASCII)
_PEAK = "Max. Acc. (gal)"
_NEEDED = ("Sampling Freq(Hz)", "Duration Time(s)", "Scale Factor", _PEAK)


def is_knet(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    return data.startswith(b"Origin Time")


def parse_knet(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a K-NET or KiK-net file: one record, its constant offset left in.

    Raises
    ------
    RecordError
        If the header lacks rate, duration, scale factor or its last line, the number of counts is not
        rate times duration, or their peak about the mean is not the header's or is not stated.
    """
    source = SourceText(name, data)
    header: dict[str, tuple[int, str]] = {}
    for index in range(min(_HEADER_LINES, len(source))):
        line = source.line(index)
        key = line[:_KEY].strip()
        if key in header:
            raise source.error(index, "says again what a line above says")
        header[key] = index, line[_KEY:].strip()
        if key.rstrip(".") == "Memo":
            break
    else:
        raise source.error(0, "the header has no line 'Memo.', after which the counts begin")
    first = index + 1
    for key in _NEEDED:
        if key not in header:
            raise source.error(index, f"the header above has no line '{key}'")
    at, text = header["Sampling Freq(Hz)"]
    rate = _RATE.fullmatch(text)
    if rate is None or not 0.0 < float(rate[1]) < math.inf:
        raise source.error(at, "expected a rate such as '100Hz'")
    step = settle_interval(source.place(at), 1.0 / float(rate[1]), sampling_interval)
    at, text = header["Scale Factor"]
    scale = _SCALE.fullmatch(text)
    if scale is None or not all(0.0 < float(part) < math.inf for part in (scale[1], scale[3])):
        raise source.error(at, "expected a factor such as '3920(gal)/6182761'")
    unit = unit_named(scale[2])
    assert unit is not None  # the pattern admits gal only
    if units is not None and units != unit:
        raise source.error(at, f"the file's own unit gal differs from the given {units}")
    at, text = header["Duration Time(s)"]
    duration = parse_number(text)
    if duration is None or duration <= 0.0:
        raise source.error(at, "expected a number of seconds above 0")
    counts = source.numbers(first, len(source), whole=True)
    if abs(len(counts) - duration * float(rate[1])) > 0.5 or len(counts) < 2:
        remedy = f"at {rate[1]} Hz the file's {len(counts)} counts last {len(counts) * step:g} s"
        raise source.error(at, remedy, f"Duration Time {text}")
    # One rounding each: the ratio first would round once more.
    counts *= float(scale[1])
    counts /= float(scale[3])
    acceleration = unit.to_si(counts, out=counts)
    at, text = header[_PEAK]
    if parse_number(text) is None:
        raise source.error(at, "expected the largest acceleration in gal, which the scale is checked by")
    extremes = np.array([np.min(acceleration), np.max(acceleration)])
    check_peak(source.place(at), text, unit, extremes - np.mean(acceleration))
    attribution = (
        ("format", "K-NET ASCII"),
        ("network", "NIED K-NET, KiK-net"),
        *((key, text) for key, (_, text) in header.items() if key),
        ("units in the file", "counts"),
    )
    return (Record(name, acceleration, step, attribution),)
