"""Memory units of random weights."""

import numpy as np

from agents.policies.recurrent_cells import ConvolutionUnit, GatedUnit, LongShortTermUnit

KINDS = (GatedUnit, LongShortTermUnit, ConvolutionUnit)


def random_unit(kind, features, units, scale=0.5):
    """A unit of a kind; a convolution of three layers that sees 1 + 2 (1 + 2 + 5) periods."""
    rng = np.random.default_rng(4)
    rows = {GatedUnit: 3, LongShortTermUnit: 4}.get(kind, 0) * units
    shapes = {
        "input_weight": (rows, features), "hidden_weight": (rows, units),
        "input_bias": (rows,), "hidden_bias": (rows,),
        **{f"conv_weight_{i}": (units, 3, units if i else features) for i in range(3)},
        **{f"conv_bias_{i}": (units,) for i in range(3)},
    }  # fmt: skip

    def part(name, axes):
        assert len(shapes[name]) == axes
        return rng.normal(0.0, scale, shapes[name]).astype(np.float32)

    return kind.read(part, (1, 2, 5))
