"""Random numbers by counting: the numbers of a table depend on its key and the control period only.

Threefry-2x64 with 13 rounds (Salmon, Moraes, Dror and Shaw, Parallel random numbers: as easy as 1, 2, 3,
SC 2011) encrypts the counter ``(control period, block)`` under the key of an episode. Nothing has to be
drawn in order, so that a table's numbers are the same in any batch, process and number of threads, and a
snapshot holds keys and counters. A block gives four standard normal numbers by the method of Box and
Muller, in single precision and with separate multiplications and additions: numpy, torch and the
compiled kernels (:mod:`shake_env.kernels.normals`) agree to the last bit.

Written against the array API, on 64-bit integers that wrap around.
"""

from __future__ import annotations

from typing import Any

import array_api_compat
import numpy as np
from numpy.typing import NDArray

Array = Any  # a numpy array or a torch tensor

ROTATIONS = (16, 42, 12, 31, 16, 32, 24, 21)
ROUNDS = 13
PARITY = 0x1BD11BDAA9FC1A22
A_BLOCK = 4  # normal numbers of a block
# First blocks: of the ground's noise, of the sensors', of their offsets and gains.
GROUND, SENSORS, OFFSETS, GAINS = 0, 1 << 32, 1 << 33, 1 << 34

# log(1 + f), sin(t) and cos(t), highest power first (Cephes, S. Moshier: logf, sinf, cosf).
LOGARITHM = (
    7.0376836292e-2, -1.1514610310e-1, 1.1676998740e-1, -1.2420140846e-1, 1.4249322787e-1,
    -1.6668057665e-1, 2.0000714765e-1, -2.4999993993e-1, 3.3333331174e-1,
)  # fmt: skip
SINE = (-1.9515295891e-4, 8.3321608736e-3, -1.6666654611e-1)
COSINE = (2.443315711809948e-5, -1.388731625493765e-3, 4.166664568298827e-2)
LN_2 = 0.69314718056
ROOT_HALF, ONE = 0x3F3504F3, 0x3F800000  # bits of sqrt(1/2) and of 1
ANGLE = 0.78539816339744831 / 2.0**29  # pi / 4 over the largest of 30 bits and a sign


def episode_key(stream: np.random.Generator) -> NDArray[np.int64]:
    """Return the key (2,) of an episode, drawn from its stream."""
    bits: Any = stream.bit_generator
    key: NDArray[np.int64] = bits.random_raw(2).view(np.int64)
    return key


def threefry(key: Array, first: Array, second: Array) -> tuple[Array, Array]:
    """Return the two words (...) that a counter is encrypted to.

    Parameters
    ----------
    key
        (..., 2) of 64-bit integers.
    first, second
        (...) the words of the counter.
    """
    keys = (key[..., 0], key[..., 1], key[..., 0] ^ key[..., 1] ^ PARITY)
    x, y = first + keys[0], second + keys[1]
    for i in range(ROUNDS):
        turn = ROTATIONS[i % len(ROTATIONS)]
        x = x + y
        # The shift to the right fills up with the sign: those bits are masked off.
        y = ((y << turn) | ((y >> (64 - turn)) & ((1 << turn) - 1))) ^ x
        if i % 4 == 3:
            s = i // 4 + 1
            x, y = x + keys[s % 3], y + keys[(s + 1) % 3] + s
    return x, y


def normals(key: Array, period: Array, first_block: int, count: int) -> Array:
    """Return the standard normal numbers of control periods.

    Parameters
    ----------
    key
        (..., 2) of the episodes, 64-bit integers.
    period
        (...) control periods since the start of each, broadcast against the keys; 64-bit integers.
    first_block
        What the numbers are for: GROUND, SENSORS, OFFSETS or GAINS.
    count
        How many of each.

    Returns
    -------
    (..., count) in double precision; each is a number of single precision.
    """
    xp = array_api_compat.array_namespace(key)
    blocks = -(-count // A_BLOCK)
    block = first_block + xp.arange(blocks, dtype=xp.int64, device=array_api_compat.device(key))
    words = threefry(key[..., None, :], period[..., None], block)
    pairs = _normal_pairs(xp.stack(words, axis=-1))
    flat = xp.reshape(xp.stack(pairs, axis=-1), (*pairs[0].shape[:-2], blocks * A_BLOCK))
    return xp.astype(flat[..., :count], xp.float64)


def _normal_pairs(words: Array) -> tuple[Array, Array]:
    """Return two normal numbers a word, single precision: radius of the low bits, angle of the high."""
    xp = array_api_compat.array_namespace(words)
    low, high = words & 0xFFFFFFFF, (words >> 32) & 0xFFFFFFFF
    # -2 log(u), u = x / 2^31, with its exponent apart so that it is exact near 1.
    x = xp.astype(low >> 1, xp.float32) + 0.5
    bits = x.view(xp.int32) + (ONE - ROOT_HALF)
    exponent = xp.astype((bits >> 23) - (127 + 31), xp.float32)
    f = ((bits & 0x007FFFFF) + ROOT_HALF).view(xp.float32) - 1.0
    square = f * f
    log = _polynomial(f, LOGARITHM) * f * square - 0.5 * square + f + exponent * LN_2
    # By way of double precision, as torch's root of single precision is not always the nearest number.
    twice = xp.astype(xp.where(log < 0.0, log * -2.0, xp.zeros_like(log)), xp.float64)
    radius = xp.astype(xp.sqrt(twice), xp.float32)
    # An angle within pi / 4 of an axis; two bits say of which.
    t = xp.astype(((high & 0x3FFFFFFF) ^ 0x20000000) - 0x20000000, xp.float32) * ANGLE
    square = t * t
    sine = _polynomial(square, SINE) * square * t + t
    cosine = _polynomial(square, COSINE) * square * square - 0.5 * square + 1.0
    radius = xp.where((high & 0x40000000) != 0, -radius, radius)
    swapped = (high & 0x80000000) != 0
    return radius * xp.where(swapped, sine, cosine), radius * xp.where(swapped, cosine, sine)


def _polynomial(x: Array, coefficients: tuple[float, ...]) -> Array:
    total = x * coefficients[0] + coefficients[1]
    for each in coefficients[2:]:
        total = total * x + each
    return total
