"""Policies on disk: weights in safetensors, everything else in its JSON header. Loading runs no code.

A `PolicyFile` is a multilayer perceptron behind a fixed linear map of the observation, with or without a
memory between them, and drives a table in numpy alone.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from agents.earlier_names import present_card
from agents.policies.estimated_law import EstimatedLaw
from agents.policies.policy_header import check_card, parse_header
from agents.policies.recurrent_cells import UNITS, MemoryUnit, Weights, initial_state
from shake_env.errors import PolicyFileError
from shake_env.files import no_file, write_bytes
from shake_env.scenario.limits import OBSERVATION_BOUND
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.tables import DEFAULT_TABLE

FORMAT = "shake-policy-1"
_REMEDY = "give a policy file written by 'shake train' (policy.safetensors)"
_ACTIVATIONS = ("tanh", "relu")
_OUTPUTS = ("clip", "tanh")
LARGEST = 1e6  # [-] of a number in a file; those that `shake train` writes stay below 1e3
LAW = {"advance": 2, "gains": 3, "show": 2, "begins": 1}  # arrays of an `EstimatedLaw`, and their axes


@dataclass(frozen=True)
class PolicyFile:
    """A deterministic policy as a `Controller`, in numpy.

    Features are ``clip(matrix @ observation)``; with a memory its output is put behind them. Then come
    layers of weights and biases with an activation between them; where the policy is direct, what enters
    the first layer also enters the last, behind its other inputs. The output is clipped to [-1, 1]
    (Gaussian policies) or passed through tanh (SAC). The action is
    ``base @ observation + authority * output``, clipped to [-1, 1]. With a law behind an estimator, what
    that shows stands behind the observation in all of this.

    Raises
    ------
    PolicyFileError
        If the shapes of its parts do not chain, or a number in it is not finite.
    """

    matrix: Weights  # (features, n)
    feature_clip: float
    weights: tuple[Weights, ...]  # layer l: (outputs, inputs)
    biases: tuple[Weights, ...]  # layer l: (outputs,)
    activation: str  # "tanh" or "relu"
    output: str  # "clip" or "tanh"
    base: Weights  # (n,) linear law that the network corrects; zeros for none
    authority: float  # what a network output of 1 adds to it
    card: dict[str, Any]  # how it was made: scenario, algorithm, command, seed, evaluation
    direct: bool = False  # whether the last layer also reads what the first does
    memory: MemoryUnit | None = None
    law: EstimatedLaw | None = None

    def __post_init__(self) -> None:
        _require(self.activation in _ACTIVATIONS, "activation", self.activation, _REMEDY)
        _require(self.output in _OUTPUTS, "output", self.output, _REMEDY)
        _require(len(self.weights) == len(self.biases) > 0, "layers", len(self.weights), _REMEDY)
        if self.law is not None:
            read = self.law.observation_size
            _require(read == self.observation_size, "law inputs", read, _REMEDY)
        width = self.matrix.shape[0]
        if self.memory is not None:
            taken = self.memory.inputs
            _require(taken == width, "memory inputs", taken, f"must be {width}")
            width += self.memory.units
        entering, last = width, len(self.weights) - 1
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            width += entering if self.direct and number == last else 0
            fits = weight.ndim == 2 and weight.shape[1] == width and bias.shape == weight.shape[:1]
            _require(fits, f"layer {number} shape", weight.shape, f"must take {width} inputs")
            width = weight.shape[0]
        _require(width == 1, "outputs", width, "a table has one current")
        _require(self.base.shape == self.matrix.shape[1:], "base shape", self.base.shape, _REMEDY)
        _require(0.0 < self.authority <= 1.0, "authority", self.authority, "must lie in 0 to 1")
        clip = self.feature_clip
        _require(0.0 < clip <= LARGEST, "feature_clip", clip, f"must lie in 0 to {LARGEST:g}")
        for name, arrays in (
            ("matrix", (self.matrix,)), ("base", (self.base,)),
            ("weights", self.weights), ("biases", self.biases),
        ):  # fmt: skip
            for array in arrays:
                _require_sane(name, array)
        for part, array in ({} if self.memory is None else self.memory.parts).items():
            _require_sane(f"memory {part}", array)
        for part in () if self.law is None else LAW:
            _require_sane(f"law {part}", getattr(self.law, part))
        check_card(self.card)

    @property
    def observation_size(self) -> int:
        """Length n of the observation it reads."""
        return int(self.matrix.shape[1]) - (self.law.shown if self.law else 0)

    def predict(
        self,
        observation: NDArray[np.float32],
        state: tuple[Any, ...] | None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[NDArray[np.float32], tuple[Any, ...] | None]:
        """Return the action (..., 1) for an observation (..., n), and the memories in a tuple."""
        if self.law is not None:
            law_state = None if state is None else state[-2:]
            age, known, shown = self.law.show_to(observation, law_state, episode_start)
            observation = np.concatenate([observation, shown.astype(self.matrix.dtype)], axis=-1)
        hidden = np.clip(observation @ self.matrix.T, -self.feature_clip, self.feature_clip)
        memory: tuple[Any, ...] | None = None
        if self.memory is not None:
            if state is None:
                past = initial_state(self.memory, hidden.shape[:-1])
            else:
                past = tuple(state[: len(self.memory.state_widths)])
                if episode_start is not None:
                    begun = np.reshape(episode_start, hidden.shape[:-1])[..., None]
                    past = tuple(np.where(begun, np.float32(0.0), part) for part in past)
            recalled, memory = self.memory(hidden, past)
            hidden = np.concatenate([hidden, recalled], axis=-1)
        entering, last = hidden, len(self.weights) - 1
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            if self.direct and number == last:
                hidden = np.concatenate([hidden, entering], axis=-1)
            hidden = hidden @ weight.T + bias
            if number < last:
                hidden = np.tanh(hidden) if self.activation == "tanh" else np.maximum(hidden, 0.0)
        output = np.tanh(hidden) if self.output == "tanh" else np.clip(hidden, -1.0, 1.0)
        action = (observation @ self.base)[..., None] + self.authority * output
        action = np.clip(action, -1.0, 1.0)
        if self.law is not None:
            memory = (*(memory or ()), self.law.keep(known, action[..., 0].astype(float)), age + 1)
        return action.astype(np.float32), memory

    def try_decisions(self) -> None:
        """Raise PolicyFileError unless a few decisions, memory included, are finite and within [-1, 1].

        The observations are zeros and alternating values at the bound of an observation.
        """
        signs = np.where(np.arange(self.observation_size) % 2, 1.0, -1.0)
        state, start = None, np.ones(3, dtype=bool)
        bound = OBSERVATION_BOUND * np.array([[0.0], [1.0], [-1.0]])
        with np.errstate(all="ignore"):  # the result is judged, not what it came from
            for _ in range(2):
                action, state = self.predict((bound * signs).astype(np.float32), state, start)
                fits = bool(np.isfinite(action).all()) and float(np.abs(action).max()) <= 1.0
                _require(fits, "trial decision", action.ravel().tolist(), _REMEDY)
                start = np.zeros(3, dtype=bool)

    def reading(self, scenario: Scenario) -> PolicyFile:
        """Return this policy as it reads a scenario's observation, checked against the scenario.

        One that was trained on a preview with samples a control period apart takes these out of a finer
        preview: its actions are the same. Any other is returned as it is.

        Raises
        ------
        PolicyFileError
            If the policy was made for another table, observation or rate; see `check`.
        """
        shown, own = scenario.observation, self
        samples, beyond = divmod(scenario.substeps, shown.preview_spacing)
        coarse = np.arange(shown.preview.start, shown.preview.stop)[samples - 1 :: max(samples, 1)]
        left_out = np.setdiff1d(np.arange(shown.preview.start, shown.preview.stop), coarse)
        places = np.delete(np.arange(shown.size), left_out)
        if not beyond and self.observation_size == len(places) < shown.size:
            believed = shown.size + np.arange(self.law.shown if self.law else 0)
            columns, width = np.concatenate([places, believed]), shown.size + len(believed)
            own = replace(
                self,
                matrix=_spread(self.matrix, columns, width),
                base=_spread(self.base, columns, width),
                law=self.law and self.law.reading(places, shown.size),
            )
        own.check(scenario)
        return own

    def check(self, scenario: Scenario) -> None:
        """Raise PolicyFileError unless the policy was made for this table, observation and rate."""
        table = self.card.get("table", DEFAULT_TABLE)
        _require(
            table == scenario.table,
            "table",
            table,
            f"is what the policy was trained for; the scenario's is {scenario.table}: train one for it",
        )
        size, rate = scenario.observation.size, scenario.control_rate
        _require(
            self.observation_size == size,
            "observation size",
            self.observation_size,
            f"the scenario's is {size}: use the storeys and the ground filter it was trained with",
        )
        trained = self.card.get("control_rate", rate)
        _require(trained == rate, "control rate", trained, f"the scenario's is {rate} Hz")

    def save(self, path: str | PathLike[str]) -> None:
        """Write the file; a reader never sees half of it."""
        path = Path(path)
        header = {
            "format": FORMAT,
            "feature_clip": self.feature_clip,
            "activation": self.activation,
            "output": self.output,
            "authority": self.authority,
            "layers": len(self.weights),
            "direct": self.direct,
            "memory": None if self.memory is None else self.memory.kind,
            "law_actions": 0 if self.law is None else self.law.actions,
            "card": self.card,
        }
        if self.memory is not None and self.memory.dilations:
            header["dilations"] = list(self.memory.dilations)
        arrays = {"matrix": self.matrix, "base": self.base}
        for number, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            arrays[f"weight.{number}"], arrays[f"bias.{number}"] = weight, bias
        for name, array in ({} if self.memory is None else self.memory.parts).items():
            arrays[f"memory.{name}"] = array
        for name in () if self.law is None else LAW:
            arrays[f"law.{name}"] = getattr(self.law, name)
        contiguous = {name: np.ascontiguousarray(a) for name, a in arrays.items()}
        write_bytes(path, save(contiguous, {"shake": json.dumps(header, sort_keys=True)}))


def file_digest(file: str | PathLike[str]) -> str:
    """Return the SHA-256 of a policy file."""
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def load_policy(path: str | PathLike[str]) -> PolicyFile:
    """Read a policy file.

    Header, shapes and numbers are checked, and a few decisions are tried, before it is returned.

    Raises
    ------
    PolicyFileError
        If the file is missing, truncated, corrupt or of another kind, or its decisions are not finite.
    """
    path = Path(path)
    if not path.is_file():
        raise PolicyFileError("policy file", str(path), f"{no_file(path)}: {_REMEDY}")
    try:
        with safe_open(str(path), framework="np") as file:
            text = (file.metadata() or {}).get("shake", "{}")
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError, TypeError) as error:
        raise PolicyFileError(
            "policy file", str(path), f"cannot be read ({error}): {_REMEDY}"
        ) from error
    header = parse_header(text)
    _require(header.get("format") == FORMAT, "format", header.get("format"), _REMEDY)
    try:
        layers = range(int(header["layers"]))
        memory = None
        if kind := header.get("memory"):  # files of before policies had one do not say
            kind = "gru" if kind is True else kind  # those of before there were two say true
            _require(kind in UNITS, "memory", kind, f"known: {', '.join(UNITS)}")
            memory = UNITS[kind].read(
                lambda name, axes: _float32(arrays[f"memory.{name}"], axes), header.get("dilations", ())
            )
            held = {name.removeprefix("memory.") for name in arrays if name.startswith("memory.")}
            _require(held == set(memory.parts), "memory arrays", sorted(held), _REMEDY)
        law, actions = None, int(header.get("law_actions", 0))
        if actions:
            law = _law({name: arrays[f"law.{name}"] for name in LAW}, actions)
        policy = PolicyFile(
            matrix=_float32(arrays["matrix"], 2),
            feature_clip=float(header["feature_clip"]),
            weights=tuple(_float32(arrays[f"weight.{i}"], 2) for i in layers),
            biases=tuple(_float32(arrays[f"bias.{i}"], 1) for i in layers),
            activation=header["activation"],
            output=header["output"],
            base=_float32(arrays["base"], 1),
            authority=float(header["authority"]),
            card=present_card(header["card"]),
            direct=bool(header.get("direct", False)),
            memory=memory,
            law=law,
        )
        policy.try_decisions()
        return policy
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, PolicyFileError):
            raise
        raise PolicyFileError("policy file", str(path), f"lacks {error}: {_REMEDY}") from error


def _law(arrays: dict[str, NDArray[Any]], actions: int) -> EstimatedLaw:
    for name, dimensions in LAW.items():
        array = arrays[name]
        fits = array.ndim == dimensions and array.dtype == np.float64 and array.size > 0
        _require(fits, f"law {name}", (array.shape, str(array.dtype)), "must be float64")
    law = EstimatedLaw(**arrays, actions=actions)
    rows = len(law.advance)
    _, estimates, readings = law.gains.shape
    fits = (
        law.advance.shape[1] == law.show.shape[1]
        and law.begins.shape == (rows,)
        and law.observation_size > 0
        and 0 < actions <= rows - readings - estimates
    )
    _require(fits, "law shape", law.advance.shape, _REMEDY)
    return law


def _spread(array: Weights, places: NDArray[np.intp], width: int) -> Weights:
    """Return columns (..., n) at their `places` among (..., width), zeros elsewhere."""
    spread = np.zeros((*array.shape[:-1], width), dtype=np.float32)
    spread[..., places] = array
    return spread


def _float32(array: NDArray[Any], dimensions: int) -> Weights:
    fits = array.ndim == dimensions and array.dtype == np.float32
    _require(
        fits, "array", (array.shape, str(array.dtype)), f"must be float32, {dimensions}-dimensional"
    )
    return array


def _require_sane(field: str, array: NDArray[Any]) -> None:
    largest = float(np.max(np.abs(array), initial=0.0))
    _require(largest <= LARGEST, field, largest, f"must be finite and at most {LARGEST:g}")


def _require(holds: bool, field: str, value: object, remedy: str) -> None:
    if not holds:
        raise PolicyFileError(field, value, remedy)
