"""The JSON header of a policy file: nesting, types and ranges are checked before anything is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from shake_env.errors import PolicyFileError

DEEPEST = 16  # levels of nesting; files written by `shake train` have 5
_REMEDY = "give a policy file written by 'shake train' (policy.safetensors)"

# Card fields that the program reads, with the type of each. Others may be there: they are not read.
TEXT, NUMBER, MAPPING = "text", "a finite number", "a mapping"
CARD = {
    "command": TEXT, "version": TEXT, "table": TEXT, "control_rate": NUMBER, "config": MAPPING,
    "evaluation": MAPPING, "first": MAPPING,
}  # fmt: skip
CONFIG = {"algorithm": TEXT, "seed": NUMBER, "scenario": MAPPING}
EVALUATION = dict.fromkeys(
    ("steps", "seconds", "best_steps", "cost_ratio", "cost", "reference_cost", "lqr_cost"), NUMBER
)
FIRST = {"sha256": TEXT, "command": TEXT}


def parse_header(text: str) -> dict[str, Any]:
    """Return the header that a policy file holds as JSON.

    Raises
    ------
    PolicyFileError
        If it is no JSON mapping, nests too deeply, or a field of its card has the wrong type.
    """
    if _depth(text) > DEEPEST:
        raise PolicyFileError("header", f"{_depth(text)} levels of nesting", f"at most {DEEPEST}")
    try:
        header = json.loads(text)
    except ValueError as error:
        raise PolicyFileError("header", str(error), _REMEDY) from error
    if not isinstance(header, dict):
        raise PolicyFileError("header", header, _REMEDY)
    if "card" in header:
        check_card(header["card"])
    return header


def check_card(card: object) -> None:
    """Raise PolicyFileError if a field of a policy's card that the program reads has the wrong type."""
    card = _mapping("card", card)
    _check("card", card, CARD)
    config = card.get("config", {})
    _check("card.config", config, CONFIG)
    algorithm = str(config.get("algorithm", "")).replace("-", "_")
    _check("card.config", config, {algorithm: MAPPING})
    _check("card.config.scenario", config.get("scenario", {}), {"scenario": TEXT})
    _check("card.evaluation", card.get("evaluation", {}), EVALUATION)
    _check("card.first", card.get("first") or {}, FIRST)
    curve = card.get("curve", [])
    pairs = isinstance(curve, list) and all(
        isinstance(row, list) and len(row) == 2 and all(_is_number(value) for value in row)
        for row in curve
    )
    if not pairs:
        raise PolicyFileError("card.curve", _short(curve), "must be pairs of steps and a cost ratio")


def _check(place: str, values: Mapping[str, Any], fields: Mapping[str, str]) -> None:
    for name, kind in fields.items():
        value = values.get(name)
        if value is None:  # files of earlier versions lack some, or write null
            continue
        fits = {
            TEXT: isinstance(value, str),
            NUMBER: _is_number(value),
            MAPPING: isinstance(value, dict),
        }[kind]
        if not fits:
            raise PolicyFileError(f"{place}.{name}", _short(value), f"must be {kind}")


def _mapping(place: str, value: object) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise PolicyFileError(place, _short(value), f"must be {MAPPING}")
    return value


def _is_number(value: object) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:  # an integer beyond the range of a float
        return False


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _depth(text: str) -> int:
    """Return how deeply the brackets of a JSON text nest; brackets inside strings do not count."""
    level = deepest = 0
    inside = escaped = False
    for character in text:
        if inside:
            if escaped:
                escaped = False
            elif character == "\\":
                escaped = True
            elif character == '"':
                inside = False
        elif character == '"':
            inside = True
        elif character in "[{":
            level += 1
            deepest = max(deepest, level)
        elif character in "]}":
            level -= 1
    return deepest
