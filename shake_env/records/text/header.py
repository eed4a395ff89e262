"""What headers of several formats share: keyed lines, Fortran formats, checks against the data."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit

LARGEST_TABLE = 4_000_000  # numbers of a binary file
LONGEST_LINE = 2000  # characters of a header line that are looked at
_BLANK_LINES = 100  # at most between channels
_FORM = re.compile(r"\((\d{1,2})([FEI])(\d{1,2})(?:\.\d{1,2})?E?\d?\)", re.IGNORECASE | re.ASCII)
_SEISMOMETERS = {"H": "a seismometer", "P": "a geophone"}  # by the second letter of a SEED code
_LENGTH = 0.006  # s: what a length of two decimals may be off, beside half a step

Keyed = dict[str, tuple[int, str]]


def lower_line(source: SourceText, index: int) -> str:
    """Return the beginning of a header's line in lower case, blanks at its ends taken off."""
    return source.line(index)[:LONGEST_LINE].strip().lower()


def behind_blank_lines(source: SourceText, index: int, marker: str = "") -> int:
    """Return the first line from `index` on that neither is blank nor begins with `marker`."""
    for at in range(index, min(index + _BLANK_LINES, len(source))):
        line = source.line(at)
        if line.strip() and not (marker and line.startswith(marker)):
            return at
    return min(index + _BLANK_LINES, len(source))


def keyed_lines(source: SourceText, first: int, last: int, marker: str = "") -> Keyed:
    """Return the lines ``key: text`` from `first` to `last` - 1, less a leading `marker`, by their keys.

    Raises
    ------
    RecordError
        If a key is there twice.
    """
    header: Keyed = {}
    for index in range(first, last):
        key, colon, text = source.line(index)[:LONGEST_LINE].removeprefix(marker).partition(":")
        if not colon:
            continue
        if key.strip() in header:
            raise source.error(index, "says again what a line above says")
        header[key.strip()] = index, text.strip()
    return header


def require_line(source: SourceText, header: Keyed, key: str, last: int) -> tuple[int, str]:
    """Return line and text of a key that a record's header must hold.

    Raises
    ------
    RecordError
        If it does not; the message names line `last`, where the header ends.
    """
    if key not in header:
        raise source.error(last, f"the header above has no line '{key}:'")
    return header[key]


def count_in(source: SourceText, index: int, text: str) -> int:
    """Return the number of samples that `text` is: a whole number, 2 at least.

    Raises
    ------
    RecordError
        If it is not.
    """
    if not (text.isascii() and text.isdigit() and len(text) < 12 and int(text) >= 2):
        raise source.error(index, "expected the number of samples, 2 at least")
    return int(text)


def value_in(source: SourceText, index: int, text: str, what: str) -> float:
    """Return the finite number above 0 that `text` is.

    Raises
    ------
    RecordError
        If it is none; the message says that it must be `what`.
    """
    value = parse_number(text)
    if value is None or value <= 0.0:
        raise source.error(index, f"expected {what}, a number above 0")
    return value


def words_after(line: str, *phrase: str) -> list[str]:
    """Return the words of a line that follow the words of `phrase`; none where it is not there."""
    words = line.replace("=", " ").replace(",", " ").split()
    lowered = [word.lower() for word in words]
    for at in range(len(words) - len(phrase)):
        if lowered[at : at + len(phrase)] == list(phrase):
            return words[at + len(phrase) :]
    return []


def fortran_form(text: str) -> tuple[int, str, int] | None:
    """Return numbers a line, form (E or I) and width of a format such as ``(8F10.5)``, or None."""
    match = _FORM.search(text[:LONGEST_LINE].replace(" ", ""))
    if match is None:
        return None
    per_line, width = int(match[1]), int(match[3])
    if not (1 <= per_line <= 20 and 4 <= width <= 20):
        return None
    return per_line, "I" if match[2] in "iI" else "E", width  # as Fortran's F reads an exponent too


def check_length(source: SourceText, index: int, points: int, step: float, stated: float) -> None:
    """Refuse a stated length [s] that is neither points times step nor one step less.

    Raises
    ------
    RecordError
        If it is off both by more than half a step and its printed digits.
    """
    if min(abs(points * step - stated), abs((points - 1) * step - stated)) > 0.5 * step + _LENGTH:
        remedy = f"{points} samples at {step:g} s last {points * step:g} s"
        raise source.error(index, remedy, f"length {stated:g} s")


def check_step(source: SourceText, index: int, step: float, stated: float) -> None:
    """Refuse a second statement of the step [s] that differs from the first.

    Raises
    ------
    RecordError
        If they differ by more than half a per cent, what its few digits take off.
    """
    if not math.isclose(step, stated, rel_tol=5e-3):
        raise source.error(index, f"the header's other step is {step:g} s", f"step {stated:g} s")


def check_peak(place: str, stated: str, unit: Unit, acceleration: FloatArray) -> None:
    """Refuse data whose peak is not the one that the header prints: a wrong unit, or damage.

    Parameters
    ----------
    place
        File and line of the header's peak.
    stated
        The peak as printed.
    unit
        Its unit.
    acceleration
        (points,) [m/s^2].

    Raises
    ------
    RecordError
        If they differ by more than 2 % and the last printed digit.
    """
    expected = abs(float(unit.to_si(np.asarray(float(stated)))))
    digit = float(unit.to_si(np.asarray(10.0 ** -len(stated.partition(".")[2]))))
    peak = max(-float(np.min(acceleration)), float(np.max(acceleration)))
    if not (math.isfinite(expected) and abs(peak - expected) <= 0.02 * expected + digit):
        remedy = f"the data's own peak is {peak / float(unit.to_si(np.asarray(1.0))):.6g} {unit}"
        raise RecordError(place, f"peak {stated}", f"{remedy}: the file is damaged or its unit wrong")


def check_peak_about_any_mean(place: str, stated: str, unit: Unit, acceleration: FloatArray) -> None:
    """Refuse a peak that the data (points,) [m/s^2] have neither about zero nor about their mean.

    Raises
    ------
    RecordError
        As :func:`check_peak` does.
    """
    try:
        check_peak(place, stated, unit, acceleration - np.mean(acceleration))
    except RecordError:
        check_peak(place, stated, unit, acceleration)


def naming(records: Iterable[Record], not_read: Iterable[str]) -> tuple[Record, ...]:
    """Return records that say what else their file holds."""
    rest = ", ".join(dict.fromkeys(not_read))
    entry = (("not read", rest),) if rest else ()
    return tuple(replace(record, attribution=(*record.attribution, *entry)) for record in records)


def labelled(records: Iterable[Record], form: str) -> tuple[Record, ...]:
    """Return records under another name of their format."""
    return tuple(
        replace(record, attribution=(("format", form), *record.attribution[1:])) for record in records
    )


def sensor_entries(code: str) -> tuple[tuple[str, str], ...]:
    """Return a channel's SEED code for a record's attribution, and what it says of the sensor."""
    code = code.strip()
    if not code:
        return ()
    kind = _SEISMOMETERS.get(code[1].upper()) if len(code) == 3 and code.isalpha() else None
    return (("channel code", code), *((("sensor", f"{kind}, channel {code}"),) if kind else ()))


def refuse_seismometers(records: Iterable[Record]) -> None:
    """Refuse records whose channel or sensor is a seismometer's.

    Raises
    ------
    RecordError
        At the first of them.
    """
    for record in records:
        sensor = dict(record.attribution).get("sensor", "")
        if sensor.startswith(tuple(_SEISMOMETERS.values())):
            raise RecordError(
                record.name,
                sensor,
                "measures velocity; if these samples are accelerations, allow it with "
                "allow_seismometers=True (--allow-seismometers)",
            )
