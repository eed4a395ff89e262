"""Plain JSON values to typed dataclasses."""

import json
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import pytest

from agents.laboratory.sequence.rehearsal import Rehearsal
from agents.plain_values import typed


@dataclass(frozen=True)
class Part:
    size: float


@dataclass(frozen=True)
class Whole:
    pairs: tuple[float, ...]
    names: list[str]
    flags: dict[str, bool]
    free: dict[str, Any]
    part: Part | None = None


WHOLE = Whole((1.0, 2.0), ["a"], {"b": True}, {"c": [1, None]}, Part(3.0))


def test_a_dataclass_survives_json():
    for whole in (WHOLE, replace(WHOLE, part=None)):
        assert typed(Whole, json.loads(json.dumps(asdict(whole)))) == whole


def test_a_rehearsal_survives_json():
    rehearsal = Rehearsal(
        truth=3, values={"mass_ratio": 0.5}, inside={"1 energy": True}, errors=[0.2, 0.3], informed=0.2,
        nominal=0.4, limits_broken=0, overridden=1, damage=1.5, iteration_damage=5.0,
        iteration_error=None,
    )  # fmt: skip
    assert typed(Rehearsal, json.loads(json.dumps(asdict(rehearsal)))) == rehearsal


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pairs": 1.0}, "pairs is 1.0: must be a list"),
        ({"pairs": ["x"]}, "pairs is 'x': must be of type float"),
        ({"names": [1]}, "names is 1: must be of type str"),
        ({"flags": {"b": 1}}, "flags.b is 1: must be of type bool"),
        ({"flags": ["b"]}, "flags is .*: must be a JSON object"),
        ({"part": {"size": True}}, "part.size is True: must be of type float"),
        ({"other": 1}, "other is unknown"),
    ],
)
def test_what_is_of_another_type_is_named(change, words):
    with pytest.raises(ValueError, match=words):
        typed(Whole, asdict(WHOLE) | change)


def test_what_is_missing_is_named():
    plain = {field.name: getattr(WHOLE, field.name) for field in fields(WHOLE) if field.name != "names"}
    with pytest.raises(ValueError, match="names"):
        typed(Whole, {**plain, "part": None})
