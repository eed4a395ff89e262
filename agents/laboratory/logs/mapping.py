"""What the columns of a foreign file are: a TOML file of column names, units and factors.

schema = 1
sampling_interval = "5 ms"     # where the file has no times
input_unit = "A"               # or "V"
[time]
column = "Time"
[channels.table_displacement]
column = "LVDT 1"
unit = "mm"
factor = -1.0
"""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.laboratory.logs.test_log import unit_of
from shake_env.errors import LogError, unknown
from shake_env.files import no_file
from shake_env.scenario.quantities import QuantityError, to_si

ENTRIES = ("schema", "sampling_interval", "input_unit", "delimiter", "time", "channels")
SOURCE = ("column", "unit", "factor", "offset")
LARGEST = 1_000_000  # bytes
DELIMITERS = (",", ";", "\t", " ")


@dataclass(frozen=True)
class ChannelSource:
    """Where a channel comes from."""

    column: str  # title in the file
    unit: str | None = None  # of the numbers there; None: as the file states
    factor: float = 1.0  # on the numbers, such as a sensitivity or -1
    offset: float = 0.0  # added afterwards, SI


@dataclass(frozen=True)
class Mapped:
    """A mapping file."""

    channels: Mapping[str, ChannelSource]  # by the name of the channel
    time: ChannelSource | None = None
    sampling_interval: float | None = None  # [s]
    input_unit: str = "A"
    delimiter: str | None = None  # of a CSV file; None: comma, semicolon or tab, as its first row has it


def read_mapping(file: str | os.PathLike[str]) -> Mapped:
    """Return a mapping file.

    Raises
    ------
    LogError
        If it cannot be read, is no TOML, or an entry is unknown, missing or of another type.
    """
    file = Path(file)
    if not file.is_file():
        raise LogError("mapping", str(file), no_file(file))
    try:
        if file.stat().st_size > LARGEST:
            raise LogError("mapping", str(file), f"is larger than {LARGEST} bytes, so it is no mapping")
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        if isinstance(error, LogError):
            raise
        raise LogError("mapping", str(file), f"is no TOML: {error}") from None
    _known(content, ENTRIES, str(file))
    if content.get("schema") != 1:
        raise LogError(f"{file}, schema", content.get("schema"), "must be 1")
    channels = content.get("channels")
    if not isinstance(channels, dict) or not channels:
        raise LogError(f"{file}, channels", channels, "must hold a table for each channel")
    for name in channels:
        unit_of(name)
    step = content.get("sampling_interval")
    if step is not None:
        try:
            step = to_si(step, "s") if isinstance(step, str) else float(step)
        except (QuantityError, TypeError, ValueError) as error:
            raise LogError(f"{file}, sampling_interval", step, str(error)) from None
    delimiter = content.get("delimiter")
    if delimiter is not None and delimiter not in DELIMITERS:
        raise LogError(f"{file}, delimiter", delimiter, f"must be one of {DELIMITERS}")
    time = content.get("time")
    return Mapped(
        channels={name: _source(each, f"{file}, channels.{name}") for name, each in channels.items()},
        time=None if time is None else _source(time, f"{file}, time"),
        sampling_interval=step,
        input_unit=str(content.get("input_unit", "A")),
        delimiter=delimiter,
    )


def _source(content: Any, place: str) -> ChannelSource:
    if not isinstance(content, dict) or not isinstance(content.get("column"), str):
        raise LogError(place, content, "must be a table with column = 'TITLE'")
    _known(content, SOURCE, place)
    unit = content.get("unit")
    if unit is not None and not isinstance(unit, str):
        raise LogError(f"{place}.unit", unit, "must be a text")
    numbers = {}
    for name, default in (("factor", 1.0), ("offset", 0.0)):
        value = content.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise LogError(f"{place}.{name}", value, "must be a finite number")
        numbers[name] = float(value)
    return ChannelSource(content["column"], unit, numbers["factor"], numbers["offset"])


def _known(content: Mapping[str, Any], names: tuple[str, ...], place: str) -> None:
    for name in content:
        if name not in names:
            raise unknown(LogError, f"entry of {place}", name, names)
