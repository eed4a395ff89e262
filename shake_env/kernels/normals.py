"""numpy's standard normal numbers from the raw numbers of its generators, compiled.

`numpy.random.Generator.standard_normal` calls a function for each number, which takes most of its time.
Here raw numbers are drawn by the hundred, and the same method (the ziggurat of Marsaglia and Tsang,
Journal of Statistical Software 5(8), 2000, with 256 layers) is applied to them in one loop: the numbers
that come of it are numpy's to the last bit. Imported on first use, where numba is installed.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
from numba import float64, int64, njit, types, uint64
from numpy.typing import NDArray

from shake_env.model.parameters import FloatArray

LAYERS = 256
MANTISSA = 2.0**52
PLACES = (1 << 52) - 1
TAIL = 3.6541528853610087963519472518  # where the lowest layer's tail begins

Raw = NDArray[np.uint64]
IntArray = NDArray[np.int64]


def tables() -> tuple[Raw, FloatArray, FloatArray]:
    """Return numpy's own tables (256,): bounds of a sure hit, widths of layers, heights of the density.

    Bounds and widths are read off numpy, by a generator whose next raw numbers are set: written anew
    from the definition, every other would differ in its last bit. The heights are computed; their last
    bit decides over one number in some 1e16.
    """
    generator = np.random.Generator(np.random.Philox(0))
    state: Any = generator.bit_generator.state

    def normal(raw: int) -> tuple[float, bool]:
        """Return the number that comes of a raw one, and whether it needed no other."""
        # With these behind it, a number beyond the layers is taken at once, and one between a box and
        # the density, too: both have read further.
        state["buffer"][:] = raw, 0, (1 << 64) - 1, 0
        state["buffer_pos"] = 0
        generator.bit_generator.state = state
        return generator.standard_normal(), generator.bit_generator.state["buffer_pos"] == 1

    widths = np.array([normal((1 << 60) | layer)[0] for layer in range(LAYERS)]) / 2.0**51
    bounds = np.zeros(LAYERS, dtype=np.uint64)
    for layer in range(LAYERS):
        # Of the lowest layer what lies before the tail is sure, of the top one nothing.
        inner = widths[layer - 1] if layer else TAIL / MANTISSA
        guess = 0 if layer == 1 else int(MANTISSA * (inner / widths[layer]))
        low, high = max(guess - 64, 0), guess + 64  # rounding moves it by a few units at most
        while low < high:
            middle = (low + high) // 2
            if normal((middle << 9) | layer)[1]:
                low = middle + 1
            else:
                high = middle
        if low == guess + 64:
            raise RuntimeError(f"layer {layer} of numpy's normal numbers is not where it was looked for")
        bounds[layer] = low
    heights = np.exp(-0.5 * (MANTISSA * widths) ** 2)
    heights[0] = 1.0
    return bounds, widths, heights


@njit(error_model="numpy", nogil=True)
def _convert(
    raw: Raw,
    at: int,
    end: int,
    out: FloatArray,
    bounds: Raw,
    widths: FloatArray,
    heights: FloatArray,
) -> tuple[int, int]:
    """Fill `out` from raw numbers `at` to `end`; return how many were made, and the place reached.

    A number whose raw ones do not all lie there is left for another time.
    """
    made = 0
    while made < len(out) and at < end:
        number = raw[at]
        layer = number & uint64(LAYERS - 1)
        place = (number >> uint64(9)) & uint64(PLACES)
        x = float64(place) * widths[layer]
        x = -x if number & uint64(LAYERS) else x
        next_raw = at + 1
        accepted = place < bounds[layer]
        if not accepted and layer == uint64(0):  # beyond all layers (Marsaglia, 1964)
            while not accepted and next_raw + 2 <= end:
                past = -(1.0 / TAIL) * math.log1p(-_share(raw[next_raw]))
                other = -math.log1p(-_share(raw[next_raw + 1]))
                accepted, next_raw = other + other > past * past, next_raw + 2
                x = -(TAIL + past) if (place >> uint64(8)) & uint64(1) else TAIL + past
            if not accepted:
                break
        elif not accepted:  # between a layer's box and the density
            if next_raw == end:
                break
            above, below = heights[layer - uint64(1)], heights[layer]
            height = (above - below) * _share(raw[next_raw]) + below
            accepted, next_raw = height < math.exp(-0.5 * x * x), next_raw + 1
        at = next_raw
        if accepted:
            out[made] = x
            made += 1
    return made, at


@njit(error_model="numpy", nogil=True)
def _share(raw: int) -> float:
    """Return a raw number as a share of all, below 1."""
    share: float = float64(raw >> uint64(11)) / 2.0**53
    return share


@njit(
    int64(
        uint64[:, ::1], int64[::1], types.Array(float64, 2, "A"), int64[::1], int64, uint64[::1],
        float64[::1], float64[::1],
    ),
    cache=True, error_model="numpy", nogil=True,
)  # fmt: skip
def convert(
    raw: Raw,
    held: IntArray,
    out: FloatArray,
    made: IntArray,
    kept: int,
    bounds: Raw,
    widths: FloatArray,
    heights: FloatArray,
) -> int:
    """Fill rows of standard normal numbers from rows of raw ones, of which each has as many as it needs.

    Parameters
    ----------
    raw
        (n or more, kept + fresh) raw numbers; those that `held` counts end at `kept`, those that are
        fresh begin there. What is not used is moved to end there.
    held
        (n,) of those before `kept`, then of those not used.
    out
        (n, count), written.
    made
        (n,) fresh raw numbers; then how much of each row is filled.
    kept
        Room for what is left.
    bounds, widths, heights
        From `tables`.

    Returns
    -------
    Number of rows that are not filled.
    """
    short = 0
    for n in range(len(out)):
        end = kept + made[n]
        made[n], at = _convert(raw[n], kept - held[n], end, out[n], bounds, widths, heights)
        held[n] = left = end - at
        for i in range(left):  # upwards where it moves down, and the other way round
            step = i if at > kept - left else left - 1 - i
            raw[n, kept - left + step] = raw[n, at + step]
        short += made[n] < out.shape[1]
    return short


@lru_cache(maxsize=1)
def numpys() -> tuple[Raw, FloatArray, FloatArray] | None:
    """Return the tables, or None where another numpy makes its numbers in another way."""
    try:
        found = tables()
    except RuntimeError:
        return None
    wanted = np.random.Generator(np.random.PCG64(0)).standard_normal((1, 4096))
    raw = np.random.PCG64(0).random_raw((1, 4500))
    out, held = np.empty((1, 4096)), np.zeros(1, dtype=np.int64)
    short = convert(raw, held, out, np.full(1, 4500), 0, *found)
    return found if not short and np.array_equal(out, wanted) else None
