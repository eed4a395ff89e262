"""ONNX files: the numpy policy's action in another runtime."""

import json
import sys

import numpy as np
import pytest
from memory_units import KINDS, random_unit

from agents.__main__ import main
from agents.policies.onnx_export import export_onnx
from agents.policies.policy_file import PolicyFile, load_policy
from agents.policies.recurrent_cells import initial_state
from agents.policies.registry import shipped_policy

onnxruntime = pytest.importorskip("onnxruntime")


def session(path):
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def made(memory, direct=False, activation="relu", output="clip"):
    """A policy of random weights: 5 observations, 4 features, 6 units of memory."""
    rng = np.random.default_rng(0)

    def array(*shape):
        return rng.normal(0.0, 0.7, shape).astype(np.float32)

    unit = None if memory is None else random_unit(memory, 4, 6)
    width = 4 + (6 if memory else 0)
    return PolicyFile(
        matrix=array(4, 5),
        feature_clip=1.5,
        weights=(array(8, width), array(1, 8 + (width if direct else 0))),
        biases=(array(8), array(1)),
        activation=activation,
        output=output,
        base=array(5) * np.float32(0.2),
        authority=0.5,
        card={"made": "here"},
        direct=direct,
        memory=unit,
    )


# Observation and weights are finite, and actions are compared. OpenBLAS can leave the flag of an invalid
# operation on memory of its own that pads a block (numpy issue 24067): it says nothing of the product.
@pytest.mark.filterwarnings("ignore:invalid value encountered in matmul:RuntimeWarning")
@pytest.mark.parametrize("memory", [None, *KINDS])
@pytest.mark.parametrize(
    ("direct", "activation", "output"), [(False, "relu", "clip"), (True, "tanh", "tanh")]
)
def test_the_graph_gives_the_numpy_policys_action(memory, direct, activation, output, tmp_path):
    policy = made(memory, direct, activation, output)
    runtime = session(export_onnx(policy, tmp_path / "policy.onnx"))
    rng = np.random.default_rng(1)
    state = () if memory is None else initial_state(policy.memory, (7,))
    kept, spread = None, 0.0
    for _ in range(20):
        observation = rng.normal(size=(7, 5)).astype(np.float32)
        expected, kept = policy.predict(observation, kept)
        given = {f"state_{i}": part for i, part in enumerate(state)}
        action, *state = runtime.run(None, {"observation": observation, **given})
        np.testing.assert_allclose(action, expected, atol=1e-5)
        for ours, theirs in zip(state, kept or (), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-5)
        spread = max(spread, np.ptp(expected))
    assert spread > 0.5


def test_the_command_exports_what_ships_with_its_card(tmp_path, capsys):
    file = tmp_path / "deep" / "linear.onnx"
    assert main(["export", "apg", str(file), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"output": str(file), "observation_size": 14, "states": 0, "units": 0}
    policy, runtime = load_policy(shipped_policy("apg")), session(file)
    observation = np.random.default_rng(0).normal(size=(50, 14)).astype(np.float32)
    action = runtime.run(None, {"observation": observation})[0]
    np.testing.assert_allclose(action, policy.predict(observation)[0], atol=1e-5)
    card = runtime.get_modelmeta().custom_metadata_map["card"]
    assert json.loads(card) == policy.card
    assert main(["export", "apg", str(tmp_path / "policy.bin")]) == 2
    assert "must end in .onnx" in capsys.readouterr().err


def test_without_onnx_the_remedy_is_said(tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert main(["export", "apg", str(tmp_path / "policy.onnx")]) == 2
    assert "pip install '.[onnx]'" in capsys.readouterr().err
