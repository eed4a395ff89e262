"""Taiwan's Central Weather Administration (before: Bureau): lines ``#Key: text``, then four columns.

The columns are time and, in the order of ``#DataSequence``, three components (``4F10.3``).
"""

from __future__ import annotations

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.header import (
    Keyed,
    check_peak,
    fortran_form,
    keyed_lines,
    require_line,
    value_in,
)
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_HEADER_LINES = 60  # at most
_COLUMNS = 4
_ROUNDING = 0.6e-3  # s: what a time of three decimals may be off
_UNEVEN = 0.02  # of a step


def is_cwa(data: bytes) -> bool:
    """Return whether a file's beginning is this format's."""
    head = data[:4000].lstrip()
    return head.startswith((b"#Earthquake Information", b"#StationCode")) and b"#SampleRate" in head


def parse_cwa(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a CWA file: one record a component, in the file's order.

    Raises
    ------
    RecordError
        If the header lacks rate, unit or order, or length, times or peaks are not the data's.
    """
    source = SourceText(name, data)
    first = 0
    while first < _HEADER_LINES and (source.line(first)[:1] == "#" or not source.line(first).strip()):
        first += 1
    header = keyed_lines(source, 0, first, "#")
    at, text = require_line(source, header, "SampleRate(Hz)", first)
    rate = value_in(source, at, text, "a rate in Hz")
    step = settle_interval(source.place(at), 1.0 / rate, sampling_interval)
    place, text = require_line(source, header, "AmplitudeUnit", first)
    unit = settle_unit(source.place(place), (text.split() or [""])[0].strip(".") or None, units)
    names = _components(source, header, first)
    values = _values(source, header, first)
    table = values.reshape(-1, _COLUMNS)
    _check_times(source, first, table[:, 0], step)
    at, text = header.get("RecordLength(sec)", (0, ""))
    length = parse_number(text)
    if length is not None and abs(len(table) - length / step) > 0.5:  # what else tells a lost row
        remedy = f"{len(table)} samples at {step:g} s last {len(table) * step:g} s"
        raise source.error(at, remedy, f"length {length:g} s")
    records = []
    for column, component in enumerate(names, start=1):
        acceleration = unit.to_si(table[:, column])
        _check_peak(source, header, component, unit, acceleration)
        attribution = (
            ("format", "CWA, CWB ASCII"),
            ("component", component),
            *((key, text) for key, (_, text) in header.items() if text),
            ("units in the file", str(unit)),
        )
        records.append(Record(f"{name} {component}", acceleration, step, attribution))
    return tuple(records)


def _components(source: SourceText, header: Keyed, last: int) -> list[str]:
    """Return the components by their order, of ``Time U(+); N(+); E(+)``."""
    at, text = require_line(source, header, "DataSequence", last)
    words = text.replace(";", " ").split()
    names = [word.removesuffix("(+)") for word in words[1:]]
    if words[:1] != ["Time"] or sorted(names) != ["E", "N", "U"]:
        raise source.error(at, "expected an order such as 'Time U(+); N(+); E(+)'")
    return names


def _values(source: SourceText, header: Keyed, first: int) -> FloatArray:
    at, text = header.get("Data", (first, ""))
    if len(source) - first < 2:
        raise source.error(at, "no rows of data follow the header: 2 samples at least")
    if not text:
        return source.numbers(first, len(source), per_line=_COLUMNS)
    form = fortran_form(f"({text.split()[0]})")
    if form is None or form[0] != _COLUMNS:
        raise source.error(at, "expected a format such as '4F10.3'")
    rows = len(source) - first
    return source.fields(first, _COLUMNS * rows, _COLUMNS, form[2], form[1])


def _check_times(source: SourceText, first: int, time: FloatArray, step: float) -> None:
    off = np.abs(time - (time[0] + step * np.arange(len(time)))) > _UNEVEN * step + _ROUNDING
    if off.any():
        row = int(np.argmax(off))
        raise source.error(first + row, f"the times are not evenly spaced by {step:g} s")


def _check_peak(
    source: SourceText, header: Keyed, component: str, unit: Unit, acceleration: FloatArray
) -> None:
    """Compare the data with ``6.999~   -7.118``, the largest and the smallest value."""
    at, text = header.get(f"AmplitudeMAX. {component}", (0, ""))
    if not text:
        return
    extremes = [part.strip() for part in text.split("~")]
    if len(extremes) != 2 or parse_number(extremes[0]) is None or parse_number(extremes[1]) is None:
        raise source.error(at, "expected the largest and the smallest value, as in '6.999~ -7.118'")
    place = source.place(at)
    try:
        check_peak(place, max(extremes, key=lambda part: abs(float(part))), unit, acceleration)
    except RecordError as error:
        raise RecordError(place, text, error.remedy) from None
