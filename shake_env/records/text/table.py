"""A table of numbers under titles: which column is time, which are accelerations, in what unit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from shake_env.errors import RecordError
from shake_env.model.parameters import FloatArray
from shake_env.records.record import Record
from shake_env.records.text.times import is_count, is_even, is_rising, step_of
from shake_env.records.text.titles import Title
from shake_env.records.units import Unit, quantity_of, settle_interval, settle_unit

_TO_SECONDS = {
    "ms": 1e-3, "msec": 1e-3, "millisecond": 1e-3, "milliseconds": 1e-3,
    "s": 1.0, "sec": 1.0, "secs": 1.0, "second": 1.0, "seconds": 1.0,
}  # fmt: skip


@dataclass
class Table:
    """Columns of numbers, and what the file says of them."""

    name: str  # of the file
    columns: list[FloatArray]  # each (rows,)
    titles: list[Title]  # of every column
    titled: bool  # whether the file has titles
    row_place: Callable[[int], str]  # file and line of a row
    title_place: str  # file and line of the titles
    unit: tuple[str, str] | None = None  # place and text of a unit that holds for all columns
    step: float | None = None  # [s] that the header states
    header: tuple[tuple[str, str], ...] = ()  # for the attribution
    wrapped: int | None = None  # values a line of a series that runs on from line to line
    taken: dict[int, str] = field(default_factory=dict)  # column: what it was taken for

    def records(
        self, units: Unit | None, sampling_interval: float | None, column: str | int | None
    ) -> tuple[Record, ...]:
        """Return one record for each column of acceleration, or the one that `column` names.

        Raises
        ------
        RecordError
            If the time, an acceleration or its unit cannot be told, or contradicts an option.
        """
        time = self._time(sampling_interval)
        step = self._step(time, sampling_interval)
        chosen = self._chosen(column, units)
        settled = [(i, self._unit(i, units)) for i in chosen]
        for index, unit in settled:
            given = self._stated(index) is None
            self.taken[index] = f"acceleration [{unit}]" + (", unit given" if given else "")
        for index in range(len(self.columns)):
            kind = self.titles[index].kind
            self.taken.setdefault(index, f"{kind or 'unknown'}, skipped")
        read_as = "; ".join(
            f"{i + 1} {self._label(i)}: {self.taken[i]}".replace(" : ", ": ")
            for i in range(len(self.columns))
        )
        if self.wrapped:
            read_as = f"one series, {self.wrapped} values a line{read_as.removeprefix('1')}"
        alone = len(self.columns) - (time is not None) - sum(t == "count" for t in self.taken.values())
        records = []
        for index, unit in settled:
            values = self.columns[index]
            acceleration = unit.to_si(values, out=values)
            acceleration.flags.writeable = False
            label = self.titles[index].text
            if self.titles[index].unit:
                label = f"{label} [{self.titles[index].unit}]"
            own = f" {label or f'column {index + 1}'}" if alone > 1 else ""
            attribution = (
                ("format", "columns"),
                *self.header,
                *((("title", label),) if label else ()),
                ("columns read as", read_as),
                ("units in the file", str(unit)),
            )
            records.append(Record(f"{self.name}{own}", acceleration, step, attribution))
        return tuple(records)

    def _label(self, index: int) -> str:
        return f"'{self.titles[index].text}'" if self.titles[index].text else ""

    def _time(self, given: float | None) -> int | None:
        """Return the column of time, if there is one, and note the count before it."""
        for index, title in enumerate(self.titles):
            if title.kind == "time":
                counting = is_count(self.columns[index])
                if counting and title.unit is None and given is None:
                    raise RecordError(
                        self.title_place, title.text,
                        "the times are 0, 1, 2, ... and may be a count: write their unit into the "
                        "title, as in 'Time (s)', or give sampling_interval",
                    )  # fmt: skip
                if index > 0 and is_count(self.columns[0]):
                    self.taken[0] = "count"
                return index
        first = 0
        if (
            len(self.columns) > 1
            and self.titles[0].kind in (None, "counts")
            and is_count(self.columns[0])
        ):
            self.taken[0], first = "count", 1
        if first + 1 >= len(self.columns) or self.titles[first].kind is not None:
            return None
        values = self.columns[first]
        if is_even(values) or is_rising(values):
            return first
        # Without titles and without a step the first column can be nothing else.
        return first if not self.titled and given is None and self.step is None else None

    def _step(self, time: int | None, given: float | None) -> float:
        if time is None:
            place = self.row_place(0)
            return settle_interval(place, self.step, given)
        unit = self.titles[time].unit
        quantity = quantity_of(unit) if unit else None
        scale = _TO_SECONDS.get(quantity[1]) if quantity else None
        if unit and scale is None:
            raise RecordError(self.title_place, unit, "the column of time must be in s or ms")
        scale = scale or 1.0
        known = given if self.step is None else self.step
        values = self.columns[time]
        step = scale * step_of(values, self.row_place, None if known is None else known / scale)
        self.taken[time] = f"time [{unit or 's'}]"
        for stated in (self.step, given):
            settle_interval(self.row_place(0), step, stated)
        return step

    def _chosen(self, column: str | int | None, units: Unit | None) -> list[int]:
        """Return the columns that are taken as accelerations: counts too, by a given sensitivity."""
        free = [i for i in range(len(self.columns)) if i not in self.taken]
        for index in free:
            if self.titles[index].contradicts:
                title = self.titles[index]
                raise RecordError(
                    self.title_place, f"{title.text} [{title.unit}]",
                    "the title and its unit name different quantities",
                )  # fmt: skip
        if column is not None:
            return [self._named(column, units)]
        kinds = {i: None if self._counted(i, units) else self.titles[i].kind for i in free}
        if definite := [i for i in free if kinds[i] == "acceleration"]:
            return definite
        unknown = [i for i in free if kinds[i] is None]
        if len(unknown) == 1:
            return unknown
        if unknown and (self.unit is not None or all(self.titles[i].component for i in unknown)):
            return unknown
        listed = ", ".join(f"{i + 1} {self._label(i)}".strip() for i in free)
        if not unknown:
            raise RecordError(self.title_place, listed, "none of the columns is an acceleration")
        raise RecordError(
            self.title_place, f"columns {listed}",
            "the file does not say which are accelerations: give column, or titles with units",
        )  # fmt: skip

    def _counted(self, index: int, units: Unit | None) -> bool:
        """Return whether a column holds counts whose sensitivity is given."""
        return self.titles[index].kind == "counts" and units is not None and units.factor != 1.0

    def _named(self, column: str | int, units: Unit | None) -> int:
        """Return the column of a title, or of a number counted from 1.

        Raises
        ------
        RecordError
            If there is none or more than one, or it is no acceleration.
        """
        matching = [
            i for i, t in enumerate(self.titles)
            if isinstance(column, str)
            and column.strip().lower() in (t.text.lower(), f"{t.text} [{t.unit}]".lower(),
                                           f"{t.text} ({t.unit})".lower())
        ]  # fmt: skip
        if not matching and (isinstance(column, int) or column.isdecimal()):
            matching = [int(column) - 1] if 1 <= int(column) <= len(self.columns) else []
        if len(matching) != 1:
            listed = ", ".join(f"{i + 1} {self._label(i)}".strip() for i in range(len(self.columns)))
            raise RecordError(f"{self.name}, column", column, f"must be one of the columns {listed}")
        index = matching[0]
        taken = self.taken.get(index) or self.titles[index].kind or "acceleration"
        if taken != "acceleration" and not self._counted(index, units):
            raise RecordError(f"{self.name}, column", column, f"is no acceleration but {taken}")
        return index

    def _stated(self, index: int) -> tuple[str, str] | None:
        own = self.titles[index].unit
        return (self.title_place, own) if own else self.unit

    def _unit(self, index: int, units: Unit | None) -> Unit:
        place, text = self._stated(index) or (self.title_place, None)
        if units is not None and self._counted(index, units):
            return units
        return settle_unit(place, text, units)
