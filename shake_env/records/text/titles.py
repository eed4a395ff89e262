"""What a column of a table is, by its title and its unit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from shake_env.records.units import quantity_of

_BRACKETED = re.compile(r"[\[(]([^\[\]()]*+(?:\([^\[\]()]*+\))?+[^\[\]()]*+)[\])]")
_UNDERSCORED = re.compile(r"([a-z]++)_(m|cm|mm)_s2", re.IGNORECASE | re.ASCII)
_LONGEST_TITLE = 200  # characters
_WORDS = re.compile(r"[^\W\d_]++")
_BEGINNINGS = {
    "acceleration": ("acc", "acel", "beschl", "ivme", "xgdd", "agdd"),
    "velocity": ("vel", "vitess", "geschw"),
    "displacement": ("disp", "depl", "desplaz", "spost", "verschieb", "weg"),
    "time": ("time", "zeit", "temps", "tempo", "tiempo", "zaman", "seconds"),
    "counts": ("count", "digit"),
    "another quantity": (
        "force", "load", "press", "volt", "curr", "temperature", "strain", "spool", "valve", "command",
        "error", "rotation", "angle", "stress",
    ),
}  # fmt: skip
_WHOLE = {
    "a": "acceleration", "ag": "acceleration", "ax": "acceleration", "ay": "acceleration",
    "az": "acceleration", "v": "velocity", "vx": "velocity", "vy": "velocity", "vz": "velocity",
    "d": "displacement", "dx": "displacement", "dy": "displacement", "dz": "displacement",
    "u": "displacement", "t": "time", "sec": "time",
}  # fmt: skip
_COMPONENTS = {
    "n", "s", "e", "w", "z", "x", "y", "h", "h1", "h2", "h3", "ns", "ew", "ud", "sn", "we", "up", "down",
    "vert", "vertical", "north", "east", "south", "west", "longitudinal", "transverse", "long", "tran",
    "raw", "corrected", "uncorrected", "filtered", "hne", "hnn", "hnz", "hn1", "hn2", "hn3", "l",
}  # fmt: skip


@dataclass(frozen=True)
class Title:
    """A column's title, the unit in it, and what they say of the column."""

    text: str  # without its unit
    unit: str | None  # as written; None where the title states none
    kind: str | None  # acceleration, velocity, displacement, time, counts, another quantity; None: open
    component: bool = False  # whether it names a direction
    contradicts: bool = False  # whether its words and its unit name different quantities


def column_title(text: str, unit: str | None = None) -> Title:
    """Return what the title of a record's column says: quantity and unit.

    Parameters
    ----------
    text
        The title.
    unit
        From a row of units; None takes what stands in brackets, or a known unit at the title's end.
    """
    text = text.strip().strip("\"'").strip()[:_LONGEST_TITLE]
    plain = text
    if not unit:
        plain, unit = _parted(text)
    unit = unit.strip("\"'[]() \t") if unit else unit
    component = _is_component(plain)
    if unit and quantity_of(unit) is None and _is_component(unit):
        plain, unit, component = text, None, True
    quantity = quantity_of(unit) if unit else None
    words = _kind_of_words(plain)
    kinds = ("acceleration", "velocity", "displacement", "time")
    by_unit = quantity[0] if quantity else None
    contradicts = words in kinds and by_unit in kinds and words != by_unit
    return Title(plain, unit or None, by_unit or words, component, contradicts)


def _parted(text: str) -> tuple[str, str | None]:
    """Return a title without its unit, and the unit."""
    for match in _BRACKETED.finditer(text):
        inside = match[1].strip()
        words = inside.split()
        if words and words[0].lower() == "in":  # "(in g)", and not "(in)", the inch
            inside = " ".join(words[1:]) or inside
        if inside:
            return (text[: match.start()] + " " + text[match.end() :]).strip(), inside
    for mark in (",", "_", " in ", " "):
        before, separator, after = text.rpartition(mark)
        quantity = quantity_of(after) if separator else None
        if quantity and _kind_of_words(before) and (mark != "_" or len(after) > 0):
            return before.strip(" ,_"), after.strip()
    joined = _UNDERSCORED.fullmatch(text)
    return (joined[1], f"{joined[2]}/s2") if joined else (text, None)


def _kind_of_words(text: str) -> str | None:
    words = [word.lower() for word in _WORDS.findall(text)]
    for word in words:
        for kind, beginnings in _BEGINNINGS.items():
            if word.startswith(beginnings):
                return kind
    return _WHOLE.get(words[0]) if len(words) == 1 else None


def _is_component(text: str) -> bool:
    words = text.lower().replace("-", " ").replace("+", " ").split()
    return bool(words) and all(w in _COMPONENTS or w in ("ch", "comp", "channel", "component")
                               or w.isdecimal() for w in words)  # fmt: skip
