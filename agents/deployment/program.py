"""The description of a program of one decision a period: blocks of constants, to be written as C.

A `Block` is one law, filter or network: its kind names a template, its constants are arrays and numbers.
A block may hold another, which it calls once a period. Nothing else is needed: the templates of
`templates/blocks/` hold the arithmetic, and the blocks are made of the Python controllers
(`agents.deployment.laws`, `agents.deployment.plant`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from agents.deployment.channels import Channel
from shake_env.errors import ParameterError
from shake_env.model.parameters import FloatArray

Precision = Literal["float64", "float32"]


@dataclass(frozen=True)
class Block:
    """One part of a program.

    The template ``templates/blocks/KIND.c`` has two macros: `state`, the members of the block's struct,
    and `code`, its functions ``KIND_reset`` and ``KIND_step``.
    """

    kind: str
    summary: str  # what it is, for a reader of the C source
    arrays: Mapping[str, FloatArray] = field(default_factory=dict)  # become static const arrays
    integers: Mapping[str, Any] = field(default_factory=dict)  # likewise, of int
    sparse: tuple[str, ...] = ()  # matrices among `arrays` that are written without their zeros
    numbers: Mapping[str, Any] = field(default_factory=dict)  # sizes, switches and scalars
    inner: Block | None = None

    @property
    def chain(self) -> list[Block]:
        """The block and those within it, innermost first."""
        return [*([] if self.inner is None else self.inner.chain), self]


@dataclass(frozen=True)
class Program:
    """One period of a controller, or of a plant: inputs to outputs, with a memory between periods.

    Raises
    ------
    ParameterError
        If its name is that of a kind of block in it, whose C functions would have the same names.
    """

    name: str  # an identifier: prefix of every function and type
    title: str  # what it is, in words
    block: Block
    inputs: tuple[Channel, ...]
    outputs: tuple[Channel, ...]
    period: float  # [s] between two steps
    accepts_any_input: bool  # whether NaN and infinity are dealt with inside; else they are refused
    provenance: Mapping[str, str]  # texts: what it was made from
    valve: Mapping[str, Any] | None = None  # numbers of the servovalve's opening, where a block asks
    precision: Precision = "float64"
    # Whether inputs in SI are rounded to float32 once scaled, as an observation is.
    rounds_inputs: bool = True

    def __post_init__(self) -> None:
        kinds = [block.kind for block in self.block.chain]
        assert len(set(kinds)) == len(kinds), "a kind of block occurs once in a program"
        if self.name in kinds:
            raise ParameterError(
                "prefix", self.name, "is the name of a part of the program: choose another"
            )


def flat(array: Any) -> FloatArray:
    """Return an array as float64, whatever its precision: the same numbers."""
    return np.ascontiguousarray(array, dtype=np.float64)
