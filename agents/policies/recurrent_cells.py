"""Recurrent units in numpy: what a policy file with a memory keeps between decisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from shake_env.errors import PolicyFileError

Weights = NDArray[np.float32]
_REMEDY = "give a policy file written by 'shake train' (policy.safetensors)"


@dataclass(frozen=True)
class _Unit:
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
    kind: ClassVar[str]
    gates: ClassVar[int]
    arrays: ClassVar[int]  # of its state

    def __post_init__(self) -> None:
        rows, units = self.hidden_weight.shape
        fits = (
            rows == self.gates * units > 0
            and self.input_weight.shape[0] == rows
            and self.input_bias.shape == self.hidden_bias.shape == (rows,)
        )
        if not fits:
            raise PolicyFileError("memory shape", self.hidden_weight.shape, _REMEDY)
        if not all(np.isfinite(getattr(self, part)).all() for part in PARTS):
            raise PolicyFileError("memory weights", "nan or inf", _REMEDY)

    @property
    def units(self) -> int:
        """Width of the memory."""
        return int(self.hidden_weight.shape[1])


class GatedUnit(_Unit):
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


class LongShortTermUnit(_Unit):
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


MemoryUnit = GatedUnit | LongShortTermUnit
UNITS: dict[str, type[GatedUnit] | type[LongShortTermUnit]] = {
    unit.kind: unit for unit in (GatedUnit, LongShortTermUnit)
}
PARTS = ("input_weight", "hidden_weight", "input_bias", "hidden_bias")


def initial_state(unit: MemoryUnit, lanes: tuple[int, ...]) -> tuple[Weights, ...]:
    """Return a recurrent unit's state at the start of an episode, arrays (*lanes, units)."""
    return tuple(np.zeros((*lanes, unit.units), np.float32) for _ in range(unit.arrays))


def _logistic(values: Weights) -> Weights:
    # By a tanh that cannot overflow.
    half = np.float32(0.5)
    logistic: Weights = half + half * np.tanh(half * values)
    return logistic
