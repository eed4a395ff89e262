"""Policy files that were changed: a policy with finite actions, or the typed error."""

import json
import struct

import numpy as np
import pytest

from agents.policies.policy_file import LARGEST, PolicyFile, load_policy
from agents.policies.policy_header import DEEPEST, check_card, parse_header
from agents.policies.registry import shipped_policy
from shake_env.errors import PolicyFileError

WHOLE = {
    name: shipped_policy("apg", name).read_bytes() for name in ("linear", "laboratory")
}  # without and with a law behind an estimator


def with_header(whole, change):
    """Return the bytes of a policy file whose shake header was changed as text."""
    length = struct.unpack("<Q", whole[:8])[0]
    header = json.loads(whole[8 : 8 + length])
    header["__metadata__"]["shake"] = change(header["__metadata__"]["shake"])
    text = json.dumps(header).encode()
    return struct.pack("<Q", len(text)) + text + whole[8 + length :]


def mutated(rng):
    """Return a shipped file with a few random edits, most of them in its header or its numbers."""
    whole = WHOLE[str(rng.choice(list(WHOLE)))]
    data = bytearray(whole)
    length = struct.unpack("<Q", whole[:8])[0]
    kind = rng.integers(4)
    if kind == 0:  # bytes of the header
        for place in rng.integers(0, 8 + length, rng.integers(1, 4)):
            data[place] = rng.integers(256)
    elif kind == 1:  # numbers, as float32 bits
        for _ in range(rng.integers(1, 20)):
            place = int(rng.integers(8 + length, len(data) - 4))
            data[place : place + 4] = rng.bytes(4)
    elif kind == 2:  # nesting and odd values in the shake header
        odd = ["[" * 5000, "NaN", "1e999", "10" * 400, '{"a":' * 40, "null", "[]", '"x"', "-1", "true"]
        return with_header(
            whole, lambda text: replaced(text, int(rng.integers(len(text))), str(rng.choice(odd)))
        )
    else:  # a value of the header
        keys = list(json.loads(headers(whole)))
        key, value = str(rng.choice(keys)), [None, [], {}, "x", -1, 1e300, float("nan"), True, [[1]]]
        chosen = value[rng.integers(len(value))]
        return with_header(whole, lambda text: json.dumps({**json.loads(text), key: chosen}))
    return bytes(data)


def headers(whole):
    length = struct.unpack("<Q", whole[:8])[0]
    return json.loads(whole[8 : 8 + length])["__metadata__"]["shake"]


def replaced(text, place, word):
    end = min((text.find(mark, place) for mark in ",}]" if text.find(mark, place) > 0), default=place)
    return text[:place] + word + text[end:]


def load_and_act(path):
    """Return whether a file gave a policy; its actions then must be finite and within [-1, 1]."""
    try:
        policy = load_policy(path)
    except PolicyFileError:
        return False
    observation = np.random.default_rng(0).normal(0.0, 3.0, (4, policy.observation_size))
    action, _ = policy.predict(observation.astype(np.float32), None, np.ones(4, dtype=bool))
    assert np.isfinite(action).all() and np.abs(action).max() <= 1.0
    return True


@pytest.mark.parametrize("count", [400, pytest.param(20_000, marks=pytest.mark.slow)])
def test_mutated_files_give_a_policy_or_the_typed_error(count, tmp_path):
    rng, path = np.random.default_rng(7), tmp_path / "mutated.safetensors"
    accepted = 0
    for _ in range(count):
        path.write_bytes(mutated(rng))
        accepted += load_and_act(path)
    assert 0 < accepted < count  # neither everything nor nothing is refused


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("[" * 100_000, "header"),
        ('{"a":' * (DEEPEST + 1) + "1" + "}" * (DEEPEST + 1), "header"),
        ("[1, 2]", "header"),
        ("not json", "header"),
    ],
)
def test_a_header_that_nests_or_is_none_is_refused(text, field):
    with pytest.raises(PolicyFileError, match=field):
        parse_header(text)


def test_brackets_inside_strings_do_not_count():
    assert parse_header(json.dumps({"a": "[" * 100, "b": '\\"[[['}))["a"] == "[" * 100


@pytest.mark.parametrize(
    ("card", "field"),
    [
        ([], "card"),
        ({"config": []}, "card.config"),
        ({"config": {"algorithm": "ppo", "ppo": 3}}, "card.config.ppo"),
        ({"config": {"algorithm": 1}}, "card.config.algorithm"),
        ({"config": {"scenario": {"scenario": 5}}}, "card.config.scenario.scenario"),
        ({"evaluation": {"seconds": "long"}}, "card.evaluation.seconds"),
        ({"evaluation": {"steps": True}}, "card.evaluation.steps"),
        ({"evaluation": {"cost_ratio": 10**400}}, "card.evaluation.cost_ratio"),
        ({"curve": [[1, 2, 3]]}, "card.curve"),
        ({"curve": [[0, float("nan")]]}, "card.curve"),
        ({"command": {}}, "card.command"),
        ({"control_rate": float("inf")}, "card.control_rate"),
        ({"first": "x"}, "card.first"),
    ],
)
def test_a_card_field_of_the_wrong_type_is_named(card, field):
    with pytest.raises(PolicyFileError, match=rf"^{field} = "):
        check_card(card)


def test_cards_that_ship_and_unknown_fields_pass():
    for path in shipped_policy().parent.glob("*.safetensors"):
        check_card(load_policy(path).card)
    check_card({"mine": [1, {"deep": None}], "evaluation": {}})


@pytest.mark.parametrize("value", [np.nan, np.inf, 2.0 * LARGEST])
@pytest.mark.parametrize("part", ["matrix", "base", "weights", "feature_clip"])
def test_numbers_beyond_reason_are_refused(value, part):
    policy = load_policy(shipped_policy())
    fields = dict(vars(policy))
    if part == "feature_clip":
        fields[part] = float(value)
    elif part == "weights":
        fields[part] = (policy.weights[0] + np.float32(value), *policy.weights[1:])
    else:
        fields[part] = fields[part] + np.float32(value)
    with pytest.raises(PolicyFileError, match=part):
        PolicyFile(**fields)


def test_a_policy_whose_decisions_are_not_finite_is_refused_at_load(tmp_path):
    policy = load_policy(shipped_policy())
    # Each weight is within its range; eight layers of them overflow float32, and inf - inf is NaN.
    width = len(policy.biases[-2])
    layers = [np.full((width, width), LARGEST, np.float32)] * 8
    last = np.where(np.arange(width) % 2, LARGEST, -LARGEST).astype(np.float32)[None]
    first = policy.weights[:-1]
    biases = (*policy.biases[:-1], *[np.ones(width, np.float32)] * 8, policy.biases[-1])
    changed = {"weights": (*first, *layers, last), "biases": biases, "activation": "relu"}
    wild = PolicyFile(**{**vars(policy), **changed, "direct": False})
    wild.save(tmp_path / "wild.safetensors")
    with pytest.raises(PolicyFileError, match="trial decision"):
        load_policy(tmp_path / "wild.safetensors")


def test_a_path_may_be_a_string(tmp_path):
    assert load_policy(str(shipped_policy())).card == load_policy(shipped_policy()).card
