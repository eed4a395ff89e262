"""CSMIP (CESMD) volume 1, uncorrected, and volume 2, corrected: channels one after another in a file.

A channel is a header of text lines, integers and reals; then one block of accelerations (volume 1) or
three of acceleration, velocity and displacement (volume 2), each under a line that states its count,
step, unit and, in newer files, its Fortran format; then a line ``/&``. Older files leave out the format.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.header import check_peak
from shake_env.records.text.source import SourceText, parse_number
from shake_env.records.units import Unit, settle_interval, settle_unit

_CHANNEL_HEADER = 80  # lines at most
_COLUMNS = 8
_FLAGS = re.IGNORECASE | re.ASCII
_BLOCK = re.compile(
    r"\s*+(\d++)\s++"
    r"(?:points\s++of\s++(accel|veloc|displ)\S*+\s++data\s++equally\s++spaced\s++at\s++([^\sa-df-z]++)\s*+sec\b"
    r"|accelerogram\s++points\s++at\s++(\S++)\s++pts/sec\b)(.*+)",
    _FLAGS,
)
_LOOKS_LIKE_BLOCK = re.compile(
    r"points\s++of\s++(?:accel|veloc|displ)\S*+\s++data\s++equally|accelerogram points", _FLAGS
)
_UNIT = re.compile(r"(?:\bin\s++units\s++of\s++|\bunits:\s*+|\bin\s++)([^\s()]++)", _FLAGS)
_FORMAT = re.compile(r"\(\s*+(\d++)\s*+f\s*+(\d++)\.(\d++)\s*+\)", _FLAGS)
_CHANNEL = re.compile(r"chan\s++(\d++)\s*+:(.*+)", _FLAGS)
_STATION_CHANNEL = re.compile(r"\(\s*+sta\s++chn\s*+:\s*+(\d++)\s*+\)", _FLAGS)
_CHANNELS = re.compile(r"\(\s*+(\d++)\s*+chns?\s++of\s++(\d++)", _FLAGS)
_POINTS = re.compile(
    r"No\.\s*+of\s*+points\s*+=\s*+(\d++)|(?<!\d)(\d++)\s++points\s++of\s++instrument", _FLAGS
)
_DECIMAL = r"(\d*+(?:\.\d*+)?+)"
_LENGTH = re.compile(rf"record\s++length\s*+=\s*+{_DECIMAL}\s*+sec", _FLAGS)
_RATE = re.compile(rf"\bat\s++(?=\d){_DECIMAL}\s*+samples/sec", _FLAGS)
_SPACING = re.compile(r"equally-spaced\s++intervals\s++of\s++(\d*+\.\d++)\s*+sec", _FLAGS)
_PEAK_1 = re.compile(r"\bmax\s*+=\s*+(-?+\d*+\.\d++)\s*+([^\s,]++)\s*+(?:,\s++)?+at\b", _FLAGS)
_PEAK_2 = re.compile(r"\s*+peak\s++acceleration\s*+=\s*+(-?+\d*+\.\d++)\s++(\S++)\s++at\b", _FLAGS)
_WORDS = re.compile(r"[a-z]{4}", _FLAGS)
_TITLE = re.compile(r"\s*+(?:un)?corrected accelerogram", _FLAGS)
_END = re.compile(r"\bchannel\s++(\d++)", _FLAGS)


def csmip_volume(data: bytes) -> int | None:
    """Return the volume, 1 or 2, that a file's first line names, or None."""
    first = data[:200].split(b"\n")[0].strip().lower()
    if first.startswith(b"uncorrected accelerogram"):
        return 1
    return 2 if first.startswith(b"corrected accelerogram") else None


def is_csmip(data: bytes) -> bool:
    """Return whether a file's first line is this format's."""
    return csmip_volume(data) is not None


@dataclass(frozen=True)
class _Block:
    kind: str  # accel, veloc or displ
    place: int  # line of its count
    interval: float  # [s]
    unit: str | None
    values: FloatArray
    after: int  # first line behind it


def parse_csmip(
    name: str, data: bytes, *, units: Unit | None = None, sampling_interval: float | None = None
) -> tuple[Record, ...]:
    """Read a CSMIP file: one record of acceleration a channel.

    Raises
    ------
    RecordError
        If counts, steps, length, unit, peak or number of channels contradict each other or the data.
    """
    source = SourceText(name, data)
    volume = csmip_volume(data)
    records: list[Record] = []
    numbers: list[int] = []
    expected = (0, 0, 0)  # line, channels in the file, channels at the station
    index = 0
    while index < len(source):
        first = index
        index = _find_block(source, first, records)
        lines = range(first, index)
        stated = _search(source, _CHANNELS, lines)
        if stated is not None:
            expected = (stated[0], int(stated[1][1][:9]), int(stated[1][2][:9]))
        blocks = _blocks(source, index, 1 if volume == 1 else 3)
        record, channel = _record(source, lines, blocks, units, sampling_interval, len(records) + 1)
        if channel in numbers:
            raise source.error(first, f"channel {channel} is there twice")
        records.append(record)
        numbers.append(channel)
        index = _after(source, blocks[-1].after, channel, _station_channel(source, lines))
    place, wanted, station = expected
    # Structures' arrays are also given out one channel a file, under the header of the whole array.
    alone = len(records) == 1 and (numbers[0] > 1 or station > 3)
    if wanted and len(records) != wanted and not alone:
        raise source.error(place, f"the file holds {len(records)} channels", f"{wanted} Chns")
    return tuple(records)


def _search(
    source: SourceText, pattern: re.Pattern[str], lines: range
) -> tuple[int, re.Match[str]] | None:
    for index in lines:
        if match := pattern.search(source.line(index)):
            return index, match
    return None


def _find_block(source: SourceText, first: int, records: list[Record]) -> int:
    if not _TITLE.match(source.line(first)):
        raise source.error(
            first, f"is more than the header of channel {len(records)} says, and no next channel"
        )
    for index in range(first, min(first + _CHANNEL_HEADER, len(source))):
        if _LOOKS_LIKE_BLOCK.search(source.line(index)):
            return index
    raise source.error(
        first, f"no line 'points of accel data' within {_CHANNEL_HEADER} lines of this channel's start"
    )


def _blocks(source: SourceText, index: int, number_of_blocks: int) -> list[_Block]:
    kinds = ("accel", "veloc", "displ")[:number_of_blocks]
    blocks: list[_Block] = []
    for kind in kinds:
        while blocks and not source.line(index).strip() and index < len(source):
            index += 1
        block = _read_block(source, index, kind, 9 if number_of_blocks == 1 else 10)
        if blocks and (len(block.values), block.interval) != (len(blocks[0].values), blocks[0].interval):
            raise source.error(
                index, f"count or step differs from the acceleration's in line {blocks[0].place + 1}"
            )
        blocks.append(block)
        index = block.after
    return blocks


def _read_block(source: SourceText, index: int, kind: str, width: int) -> _Block:
    match = _BLOCK.fullmatch(source.line(index))
    if match is None or (match[2] or "accel").lower() != kind:
        raise source.error(index, f"expected the count, step and unit of the {kind} data")
    count, rate_or_step, rest = int(match[1][:18]), parse_number(match[3] or match[4]), match[5]
    if rate_or_step is None or rate_or_step <= 0.0:
        raise source.error(index, "the step must be a number above 0")
    if count < 2:
        raise source.error(index, "must hold 2 points at least")
    columns = _COLUMNS
    if form := _FORMAT.search(rest):
        columns, width = int(form[1][:3]), int(form[2][:3])
        if not (1 <= columns <= 20 and 4 <= width <= 20):
            raise source.error(
                index, "is no format of 1 to 20 columns, 4 to 20 characters each", form[0]
            )
    elif "(8f" in rest.lower() or re.search(r"\bformat\b", rest, re.IGNORECASE):
        raise source.error(index, "expected a format such as '(8f9.6)' at its end")
    else:
        held = len(source.line(index + 1).rstrip())
        width = (
            held // columns if held in (8 * columns, 9 * columns, 10 * columns, 12 * columns) else width
        )
    unit = _UNIT.search(rest)
    values = source.fields(index + 1, count, columns, width)
    interval = rate_or_step if match[3] else 1.0 / rate_or_step
    return _Block(kind, index, interval, unit and unit[1], values, index + 1 - (-count // columns))


def _station_channel(source: SourceText, lines: range) -> int | None:
    """Return the station's number of a channel, where the header states it beside the recorder's."""
    match = _search(source, _STATION_CHANNEL, lines)
    return int(match[1][1][:9]) if match else None


def _after(source: SourceText, index: int, channel: int, station_channel: int | None) -> int:
    """Return the line where the next channel begins."""
    marked = False
    while index < len(source):
        line = source.line(index)
        if line.startswith("/") and not marked:
            end = _END.search(line) if line.startswith("/&") else None
            if end and int(end[1][:9]) not in (channel, station_channel):
                raise source.error(index, f"ends another channel than {channel}, which stands above")
            marked = True
        elif line.strip():
            break
        index += 1
    return index


def _record(
    source: SourceText,
    lines: range,
    blocks: list[_Block],
    units: Unit | None,
    sampling_interval: float | None,
    order: int,
) -> tuple[Record, int]:
    block = blocks[0]
    corrected = len(blocks) > 1
    unit = settle_unit(source.place(block.place), block.unit, units)
    interval = settle_interval(source.place(block.place), block.interval, sampling_interval)
    acceleration = unit.to_si(block.values, out=block.values)
    _check_header(source, lines, len(acceleration), interval)
    if peak := _search(source, _PEAK_2 if corrected else _PEAK_1, lines):
        check_peak(
            source.place(peak[0]),
            peak[1][1],
            settle_unit(source.place(peak[0]), peak[1][2], None),
            acceleration,
        )
    texts = [source.line(i).strip() for i in lines]
    channel, label = order, ""
    for text in texts:
        if match := _CHANNEL.fullmatch(text):
            channel, label = int(match[1][:9]), match[2].strip()
            if beside := _STATION_CHANNEL.search(label):  # what follows it is the location
                label = label[: beside.start()].strip()
    header = [
        (f"header line {i + 1}", text) for i, text in enumerate(texts) if text and _WORDS.search(text)
    ]
    attribution = (
        ("format", f"CSMIP volume {2 if corrected else 1}"),
        ("component", label or f"channel {channel}"),
        *header,
        ("units in the file", str(unit)),
    )
    name = f"{source.name} channel {channel}" + (f" ({label})" if label else "")
    return Record(name, acceleration, interval, attribution), channel


def _check_header(source: SourceText, lines: range, points: int, interval: float) -> None:
    """Refuse a channel whose header and block disagree about count, step or length."""
    if match := _search(source, _POINTS, lines):
        stated = match[1][1] or match[1][2]
        if int(stated[:18]) != points:
            raise source.error(match[0], f"the block below states {points} points", f"{stated} points")
    for pattern, rate in ((_RATE, True), (_SPACING, False)):
        if (match := _search(source, pattern, lines)) and (value := float(match[1][1])) > 0.0:
            step = 1.0 / value if rate else value
            if abs(step - interval) > 1e-6 * interval:
                raise source.error(
                    match[0], f"the block below states a step of {interval:g} s", f"step {step:g} s"
                )
    match = _search(source, _LENGTH, lines)
    length = parse_number(match[1][1]) if match else None
    if match and length is not None and abs(points * interval - length) > 2.0 * interval + 1e-3:
        remedy = f"{points} points at {interval:g} s last {points * interval:g} s"
        raise source.error(match[0], remedy, f"Record Length {match[1][1]} sec")
