"""A policy file as an ONNX graph: the whole controller, from observation to action, for other runtimes.

The graph is written from the policy file itself, so that it holds what the numpy policy computes:
feature map, network, memory, output and base law. A memory is an input and an output.
"""

from __future__ import annotations

import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.policies.policy_file import PolicyFile
from agents.policies.recurrent_cells import ConvolutionUnit, GatedUnit, LongShortTermUnit, MemoryUnit
from shake_env.errors import PolicyFileError, ShakeError, install_hint
from shake_env.files import write_bytes

OPSET = 17
IR_VERSION = 8  # of 2022, that goes with this opset: older runtimes read it, too


class _Graph:
    """Nodes and constants as they are added; every node's output has a name of its own."""

    def __init__(self, helper: Any, numpy_helper: Any) -> None:
        self._helper, self._numpy_helper = helper, numpy_helper
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, array: NDArray[Any]) -> str:
        name = f"constant_{len(self.constants)}"
        self.constants.append(self._numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

    def number(self, value: float) -> str:
        return self.constant(np.asarray(value, dtype=np.float32))

    def add(self, kind: str, *inputs: str, outputs: int = 1, **attributes: Any) -> Any:
        names = [f"{kind.lower()}_{len(self.nodes)}_{i}" for i in range(outputs)]
        self.nodes.append(self._helper.make_node(kind, list(inputs), names, **attributes))
        return names[0] if outputs == 1 else names

    def affine(self, value: str, weight: NDArray[Any], bias: NDArray[Any]) -> str:
        product = self.add("MatMul", value, self.constant(weight.T))
        name: str = self.add("Add", product, self.constant(bias))
        return name

    def split(self, value: str, width: int, parts: int) -> Any:
        sizes = self.constant(np.full(parts, width, dtype=np.int64))
        return self.add("Split", value, sizes, outputs=parts, axis=-1)

    def clip(self, value: str, bound: float) -> str:
        name: str = self.add("Clip", value, self.number(-bound), self.number(bound))
        return name


def export_onnx(policy: PolicyFile, path: str | PathLike[str]) -> Path:
    """Write a policy as ONNX.

    Inputs are ``observation`` (N, n) and, with a memory, ``state_0`` and the further arrays of its state
    (`MemoryUnit.state_widths`), (N, width), zeros at the start of an episode. Outputs are ``action``
    (N, 1), within [-1, 1], and ``next_state_0`` and so on. The card is in the model's metadata.

    Raises
    ------
    ShakeError
        If onnx is not installed.
    PolicyFileError
        If the network reads more than the observation, such as what an estimator shows.
    """
    path = Path(path)
    if policy.matrix.shape[1] != policy.observation_size:
        raise PolicyFileError("policy", policy.matrix.shape, "an estimator's part has no ONNX form yet")
    try:
        import onnx
        from onnx import TensorProto, helper, numpy_helper
    except ImportError:
        raise ShakeError("onnx", "missing", install_hint("onnx")) from None
    graph = _Graph(helper, numpy_helper)
    hidden = graph.clip(
        graph.add("MatMul", "observation", graph.constant(policy.matrix.T)), policy.feature_clip
    )
    states: list[str] = []
    if policy.memory is not None:
        recalled, states = _recall(graph, policy.memory, hidden)
        hidden = graph.add("Concat", hidden, recalled, axis=-1)
    entering, last = hidden, len(policy.weights) - 1
    for number, (weight, bias) in enumerate(zip(policy.weights, policy.biases, strict=True)):
        if policy.direct and number == last:
            hidden = graph.add("Concat", hidden, entering, axis=-1)
        hidden = graph.affine(hidden, weight, bias)
        if number < last:
            hidden = graph.add("Tanh" if policy.activation == "tanh" else "Relu", hidden)
    output = graph.add("Tanh", hidden) if policy.output == "tanh" else graph.clip(hidden, 1.0)
    correction = graph.add("Mul", output, graph.number(policy.authority))
    law = graph.add("MatMul", "observation", graph.constant(policy.base[:, None]))
    action = graph.clip(graph.add("Add", law, correction), 1.0)
    renamed = {"action": action, **{f"next_state_{i}": name for i, name in enumerate(states)}}
    for name, made in renamed.items():
        graph.nodes.append(helper.make_node("Identity", [made], [name]))

    widths = () if policy.memory is None else policy.memory.state_widths

    def values(first: str, width: int, state: str) -> list[Any]:
        named = {first: width, **{f"{state}_{i}": each for i, each in enumerate(widths)}}
        kind = TensorProto.FLOAT
        return [helper.make_tensor_value_info(n, kind, ["N", size]) for n, size in named.items()]

    model = helper.make_model(
        helper.make_graph(
            graph.nodes,
            "shake_policy",
            values("observation", policy.observation_size, "state"),
            values("action", 1, "next_state"),
            graph.constants,
        ),
        opset_imports=[helper.make_opsetid("", OPSET)],
        producer_name="shake-env",
        ir_version=IR_VERSION,
    )
    helper.set_model_props(model, {"card": json.dumps(policy.card, sort_keys=True)})
    onnx.checker.check_model(model, full_check=True)
    write_bytes(path, model.SerializeToString())
    return path


def _recall(graph: _Graph, unit: MemoryUnit, features: str) -> tuple[str, list[str]]:
    """Add a memory's equations (see `recurrent_cells`); return its output and its new state."""
    if isinstance(unit, ConvolutionUnit):
        return _convolve(graph, unit, features)
    assert isinstance(unit, GatedUnit | LongShortTermUnit)
    n = unit.units
    new = graph.affine(features, unit.input_weight, unit.input_bias)
    old = graph.affine("state_0", unit.hidden_weight, unit.hidden_bias)
    if isinstance(unit, GatedUnit):
        (r, z, c), (r_old, z_old, c_old) = graph.split(new, n, 3), graph.split(old, n, 3)
        reset = graph.add("Sigmoid", graph.add("Add", r, r_old))
        update = graph.add("Sigmoid", graph.add("Add", z, z_old))
        proposed = graph.add("Tanh", graph.add("Add", c, graph.add("Mul", reset, c_old)))
        change = graph.add("Mul", update, graph.add("Sub", "state_0", proposed))
        memory = graph.add("Add", proposed, change)
        return memory, [memory]
    i, f, g, o = graph.split(graph.add("Add", new, old), n, 4)
    let_in = graph.add("Mul", graph.add("Sigmoid", i), graph.add("Tanh", g))
    cell = graph.add("Add", graph.add("Mul", graph.add("Sigmoid", f), "state_1"), let_in)
    hidden = graph.add("Mul", graph.add("Sigmoid", o), graph.add("Tanh", cell))
    return hidden, [hidden, cell]


def _convolve(graph: _Graph, unit: ConvolutionUnit, values: str) -> tuple[str, list[str]]:
    """Add convolutions over the last features; return their output and new state."""
    states = []
    for number, (weight, bias, d) in enumerate(
        zip(unit.weights, unit.biases, unit.dilations, strict=True)
    ):
        units, taps, inputs = weight.shape
        known = graph.add("Concat", f"state_{number}", values, axis=-1)
        columns = np.arange(taps)[:, None] * d * inputs + np.arange(inputs)
        read = graph.add("Gather", known, graph.constant(columns.ravel()), axis=-1)
        made = graph.add("Relu", graph.affine(read, weight.reshape(units, -1), bias))
        values = graph.add("Add", values, made) if number else made
        kept = np.arange(inputs, ((taps - 1) * d + 1) * inputs)
        states.append(graph.add("Gather", known, graph.constant(kept), axis=-1))
    return values, states
