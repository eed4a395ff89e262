"""Standard normal numbers of a block of tables; :mod:`shake_env.model.random_numbers` to the bit."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from shake_env.kernels.vectors import F32, F64, I32, I64, NUMBERS, Code, Rows, Value, whole
from shake_env.model.random_numbers import (
    ANGLE,
    COSINE,
    LN_2,
    LOGARITHM,
    ONE,
    PARITY,
    ROOT_HALF,
    ROTATIONS,
    ROUNDS,
    SINE,
)

BLOCKS_ALONE = 4  # blocks of a table alone that are encrypted side by side


def threefry(key: tuple[Value, Value], first: Value, second: Value) -> tuple[Value, Value]:
    """Return the two words that a counter is encrypted to."""
    keys = (key[0], key[1], key[0] ^ key[1] ^ PARITY)
    x, y = first + keys[0], second + keys[1]
    for i in range(ROUNDS):
        x = x + y
        y = y.turned(ROTATIONS[i % len(ROTATIONS)]) ^ x
        if i % 4 == 3:
            s = i // 4 + 1
            x, y = x + keys[s % 3], y + keys[(s + 1) % 3] + s
    return x, y


def normal_pairs(low: Value, high: Value) -> tuple[Value, Value]:
    """Return two normal numbers of single precision from 32-bit integers."""
    x = (low >> 1).to(F32) + 0.5
    bits = x.as_bits(I32) + (ONE - ROOT_HALF)
    exponent = ((bits >> 23) - (127 + 31)).to(F32)
    f = ((bits & 0x007FFFFF) + ROOT_HALF).as_bits(F32) - 1.0
    square = f * f
    log = _polynomial(f, LOGARITHM) * f * square - square * 0.5 + f + exponent * LN_2
    radius = (log < 0.0).choose(log * -2.0, 0.0).root()
    t = (high << 2).signed_shift(2).to(F32) * ANGLE
    square = t * t
    sine = _polynomial(square, SINE) * square * t + t
    cosine = _polynomial(square, COSINE) * square * square - square * 0.5 + 1.0
    radius = (radius.as_bits(I32) ^ ((high << 1) & 0x80000000)).as_bits(F32)
    swapped = high < 0
    return radius * swapped.choose(sine, cosine), radius * swapped.choose(cosine, sine)


def _polynomial(x: Value, coefficients: tuple[float, ...]) -> Value:
    total = x * coefficients[0] + coefficients[1]
    for each in coefficients[2:]:
        total = total * x + each
    return total


def draw(
    code: Code, keys: Rows, counters: Rows, behind: Any, first: int, blocks: Any, out: Rows
) -> None:
    """Write the numbers of `blocks` blocks of each table to rows: four a block, a table alone sixteen.

    Parameters
    ----------
    keys, counters
        Two rows and one row of 64-bit integers.
    behind
        What is taken off the counters.
    first
        The first block, for what they are drawn.
    out
        Written, up to the next multiple of 16 rows.
    """
    emit = _emit_alone if code.block == 1 else _emit_block
    function = code.function("normals", [NUMBERS, NUMBERS, I64, I64, I64, NUMBERS], emit)
    code.call(function, keys.pointer, counters.pointer, behind, first, blocks, out.pointer)


def _emit_block(
    code: Code, keys: Any, counters: Any, behind: Any, first: Any, blocks: Any, out: Any
) -> None:
    key, counter, rows = Rows(code, keys), Rows(code, counters), Rows(code, out)
    with code.loop(blocks) as j:
        block = code.value(code.b.add(first, j))
        words = []
        for v in range(0, code.block, code.wide):
            count = counter.get(0, v, I64) - code.value(behind)
            pair = (key.get(0, v, I64), key.get(1, v, I64))
            words.append(threefry(pair, count, count.like(block)))
        for h in range(0, len(words), 2):
            for place in range(2):
                both = [words[h + i][place] for i in range(2)]
                low = both[0].to(I32).followed_by(both[1].to(I32))
                high = (both[0] >> 32).to(I32).followed_by((both[1] >> 32).to(I32))
                for i, z in enumerate(normal_pairs(low, high)):
                    row = code.b.add(code.b.mul(j, whole(4)), whole(2 * place + i))
                    for half in range(2):
                        part = z.part(code.wide * half, code.wide).to(F64)
                        rows.put(row, code.wide * (h + half), part)


def _emit_alone(
    code: Code, keys: Any, counters: Any, behind: Any, first: Any, blocks: Any, out: Any
) -> None:
    key = code.b.bitcast(keys, I64.as_pointer())
    pair = [code.load(key, place, 1) for place in range(2)]
    count = code.load(code.b.bitcast(counters, I64.as_pointer()), 0, 1) - code.value(behind)
    steps = Value(code.b, ir.Constant(ir.VectorType(I64, BLOCKS_ALONE), list(range(BLOCKS_ALONE))))
    groups = code.b.udiv(code.b.add(blocks, whole(BLOCKS_ALONE - 1)), whole(BLOCKS_ALONE))
    with code.loop(groups) as group:
        begin = code.b.add(first, code.b.mul(group, whole(BLOCKS_ALONE)))
        block = steps + code.value(begin)
        x, y = threefry((steps.like(pair[0]), steps.like(pair[1])), steps.like(count), block)
        words = x.shuffled(y, [i // 2 + BLOCKS_ALONE * (i % 2) for i in range(2 * BLOCKS_ALONE)])
        z = normal_pairs(words.to(I32), (words >> 32).to(I32))
        both = z[0].shuffled(z[1], [i // 2 + z[0].count * (i % 2) for i in range(2 * z[0].count)])
        for half in range(2):
            place = code.b.add(code.b.mul(group, whole(16)), whole(8 * half))
            code.store(out, place, both.part(8 * half, 8).to(F64))
