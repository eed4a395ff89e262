"""Memory units in numpy: what a policy file with a memory keeps between decisions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import PolicyFileError

Weights = NDArray[np.float32]
PartReader = Callable[[str, int], Weights]  # a unit's array by its name and number of axes
_REMEDY = "give a policy file written by 'shake train' (policy.safetensors)"
_PARTS = ("input_weight", "hidden_weight", "input_bias", "hidden_bias")  # of a recurrent unit
KERNEL = 3  # values that a layer of a new convolution reads
# Control periods between them, a layer each: 1 + 2 (1 + 4 + 16) = 43 are seen, 0.215 s at 200 Hz.
DILATIONS = (1, 4, 16)
LONGEST = 4096  # control periods that a convolution of a file may see


class MemoryUnit(ABC):
    """What stands behind a policy's features and remembers past ones; its state begins at zero."""

    kind: ClassVar[str]
    entry: ClassVar[str]  # the part whose last axis are the features
    dilations: tuple[int, ...] = ()  # of convolutions [control periods]

    @classmethod
    @abstractmethod
    def read(cls, part: PartReader, dilations: Sequence[int]) -> Self:
        """Return the unit of what `part` returns for each name and number of axes."""

    @property
    @abstractmethod
    def parts(self) -> dict[str, Weights]:
        """Its weights by their names in a file."""

    @abstractmethod
    def with_parts(self, parts: Mapping[str, Weights]) -> Self:
        """Return the unit with other arrays in the place of its weights."""

    @property
    @abstractmethod
    def units(self) -> int:
        """Width of its output."""

    @property
    @abstractmethod
    def state_widths(self) -> tuple[int, ...]:
        """Width of each array of its state."""

    @abstractmethod
    def __call__(
        self, features: Weights, state: Sequence[Weights]
    ) -> tuple[Weights, tuple[Weights, ...]]:
        """Return output (..., units) and new state for features (..., inputs) and the state."""

    @property
    def inputs(self) -> int:
        """Number of features that it reads."""
        return int(self.parts[self.entry].shape[-1])

    @property
    def summary(self) -> str:
        """Kind and size in words."""
        return f"{self.kind}, {self.units} units"

    def _require_finite(self) -> None:
        if not all(np.isfinite(part).all() for part in self.parts.values()):
            raise PolicyFileError("memory weights", "nan or inf", _REMEDY)


@dataclass(frozen=True)
class _RecurrentUnit(MemoryUnit):
    """Weights of a recurrent unit; its gates lie one below the other.

    Raises
    ------
    PolicyFileError
        If the shapes of its parts do not fit, or a number in it is not finite.
    """

    input_weight: Weights  # (gates units, features)
    hidden_weight: Weights  # (gates units, units)
    input_bias: Weights  # (gates units,)
    hidden_bias: Weights  # (gates units,)
    gates: ClassVar[int]
    arrays: ClassVar[int]  # of its state
    entry = "input_weight"

    def __post_init__(self) -> None:
        rows, units = self.hidden_weight.shape
        fits = (
            rows == self.gates * units > 0
            and self.input_weight.shape[0] == rows
            and self.input_bias.shape == self.hidden_bias.shape == (rows,)
        )
        if not fits:
            raise PolicyFileError("memory shape", self.hidden_weight.shape, _REMEDY)
        self._require_finite()

    @classmethod
    def read(cls, part: PartReader, dilations: Sequence[int]) -> Self:
        """Return the unit of what `part` returns for each name and number of axes."""
        return cls(*(part(name, axes) for name, axes in zip(_PARTS, (2, 2, 1, 1), strict=True)))

    @property
    def parts(self) -> dict[str, Weights]:
        """Its weights by their names in a file."""
        return {name: getattr(self, name) for name in _PARTS}

    def with_parts(self, parts: Mapping[str, Weights]) -> Self:
        """Return the unit with other arrays in the place of its weights."""
        return replace(self, **parts)

    @property
    def units(self) -> int:
        """Width of the memory."""
        return int(self.hidden_weight.shape[1])

    @property
    def state_widths(self) -> tuple[int, ...]:
        """Width of each array of its state."""
        return (self.units,) * self.arrays


class GatedUnit(_RecurrentUnit):
    """A gated recurrent unit (Cho et al., 2014) in numpy, gates in torch's order: reset, update, new."""

    kind, gates, arrays = "gru", 3, 1

    def __call__(
        self, features: Weights, state: Sequence[Weights]
    ) -> tuple[Weights, tuple[Weights, ...]]:
        """Return output (..., units) and new state for features (..., features) and the state."""
        (memory,) = state
        n = self.units
        new = features @ self.input_weight.T + self.input_bias
        old = memory @ self.hidden_weight.T + self.hidden_bias
        gates = _logistic(new[..., : 2 * n] + old[..., : 2 * n])
        reset, update = gates[..., :n], gates[..., n:]
        proposed = np.tanh(new[..., 2 * n :] + reset * old[..., 2 * n :])
        hidden: Weights = proposed + update * (memory - proposed)
        return hidden, (hidden,)


class LongShortTermUnit(_RecurrentUnit):
    """A long short-term memory (Hochreiter and Schmidhuber, 1997; forget gate of Gers et al., 2000).

    Gates in torch's order: input, forget, cell, output. The state is output and cell.
    """

    kind, gates, arrays = "lstm", 4, 2

    def __call__(
        self, features: Weights, state: Sequence[Weights]
    ) -> tuple[Weights, tuple[Weights, ...]]:
        """Return output (..., units) and new state for features (..., features) and the state."""
        hidden, cell = state
        n = self.units
        sums = features @ self.input_weight.T + self.input_bias
        sums = sums + hidden @ self.hidden_weight.T + self.hidden_bias
        gates = _logistic(sums[..., : 2 * n])
        let_in, forget = gates[..., :n], gates[..., n:]
        cell = forget * cell + let_in * np.tanh(sums[..., 2 * n : 3 * n])
        hidden = _logistic(sums[..., 3 * n :]) * np.tanh(cell)
        return hidden, (hidden, cell)


@dataclass(frozen=True)
class ConvolutionUnit(MemoryUnit):
    """Causal dilated convolutions over past features (Bai, Kolter and Koltun, 2018) in numpy.

    A layer reads K values of the layer before, d control periods apart:
    ``y[t] = relu(W[:, 0] x[t - (K - 1) d] + ... + W[:, K - 1] x[t] + b)``, and from the second layer on
    ``x[t]`` is added to it. Values of before the episode are zero. The state is what each layer will
    still read: its last (K - 1) d values, the oldest first. Of the source's residual blocks this is one
    with a single convolution, without weight normalisation and dropout.

    Raises
    ------
    PolicyFileError
        If the shapes of its parts do not fit, it sees more than :data:`LONGEST` control periods, or a
        number in it is not finite.
    """

    weights: tuple[Weights, ...]  # a layer: (units, K, inputs), the oldest value first
    biases: tuple[Weights, ...]  # a layer: (units,)
    dilations: tuple[int, ...]  # d of each layer [control periods]
    kind, entry = "tcn", "conv_weight_0"

    def __post_init__(self) -> None:
        if not self.dilations or any(type(d) is not int or d < 1 for d in self.dilations):
            raise PolicyFileError("memory dilations", self.dilations, "must be whole numbers from 1 on")
        shapes = [weight.shape for weight in self.weights]
        units, taps = shapes[0][:2] if shapes and len(shapes[0]) == 3 else (0, 0)
        fits = (
            len(shapes) == len(self.biases) == len(self.dilations)
            and units > 0
            and taps > 1
            and all(shape == (units, taps, units) for shape in shapes[1:])
            and all(bias.shape == (units,) for bias in self.biases)
        )
        if not fits:
            raise PolicyFileError("memory shape", shapes, _REMEDY)
        if self.seen > LONGEST:
            remedy = f"see {self.seen} control periods, at most {LONGEST}"
            raise PolicyFileError("memory dilations", self.dilations, remedy)
        self._require_finite()

    @classmethod
    def read(cls, part: PartReader, dilations: Sequence[int]) -> Self:
        """Return the unit of what `part` returns for each name and number of axes."""
        layers = range(len(dilations))
        weights = tuple(part(f"conv_weight_{i}", 3) for i in layers)
        return cls(weights, tuple(part(f"conv_bias_{i}", 1) for i in layers), tuple(dilations))

    @property
    def parts(self) -> dict[str, Weights]:
        """Its weights by their names in a file."""
        named = {"weight": self.weights, "bias": self.biases}
        return {f"conv_{name}_{i}": a for name, arrays in named.items() for i, a in enumerate(arrays)}

    def with_parts(self, parts: Mapping[str, Weights]) -> Self:
        """Return the unit with other arrays in the place of its weights."""
        return self.read(lambda name, axes: parts[name], self.dilations)

    @property
    def units(self) -> int:
        """Width of each layer, and of the output."""
        return int(self.weights[0].shape[0])

    @cached_property
    def state_widths(self) -> tuple[int, ...]:
        """Width of each array of its state, one a layer."""
        shapes = (weight.shape for weight in self.weights)
        return tuple(
            (taps - 1) * d * inputs for (_, taps, inputs), d in zip(shapes, self.dilations, strict=True)
        )

    @property
    def seen(self) -> int:
        """Control periods that an output depends on, its own included."""
        return 1 + (int(self.weights[0].shape[1]) - 1) * sum(self.dilations)

    @property
    def summary(self) -> str:
        """Kind and size in words."""
        apart = " ".join(map(str, self.dilations))
        return f"{super().summary}, kernel {self.weights[0].shape[1]}, dilations {apart}"

    def __call__(
        self, features: Weights, state: Sequence[Weights]
    ) -> tuple[Weights, tuple[Weights, ...]]:
        """Return output (..., units) and new state for features (..., inputs) and the state."""
        values, kept = features, []
        for number, (weight, bias, d) in enumerate(
            zip(self.weights, self.biases, self.dilations, strict=True)
        ):
            units, taps, inputs = weight.shape
            known = np.concatenate([state[number], values], axis=-1)
            lanes = known.shape[:-1]
            read = known.reshape(*lanes, -1, inputs)[..., ::d, :].reshape(*lanes, taps * inputs)
            made = np.maximum(read @ weight.reshape(units, -1).T + bias, 0.0)
            values = values + made if number else made
            kept.append(known[..., inputs:])
        return values, tuple(kept)


UNITS: dict[str, type[MemoryUnit]] = {
    unit.kind: unit for unit in (GatedUnit, LongShortTermUnit, ConvolutionUnit)
}


def initial_state(unit: MemoryUnit, lanes: tuple[int, ...]) -> tuple[Weights, ...]:
    """Return a memory unit's state at the start of an episode, arrays (*lanes, width)."""
    return tuple(np.zeros((*lanes, width), np.float32) for width in unit.state_widths)


def _logistic(values: Weights) -> Weights:
    # By a tanh that cannot overflow.
    half = np.float32(0.5)
    logistic: Weights = half + half * np.tanh(half * values)
    return logistic
