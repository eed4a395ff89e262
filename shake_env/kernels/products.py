"""A matrix times the rows of a block, with its sums in registers.

Sums run over the columns in order, each step rounded once where the processor multiplies and adds at
once: a table's sums are the same alone as in a block.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from shake_env.kernels.vectors import (
    I64,
    NUMBERS,
    VECTOR,
    Code,
    Rows,
    Variable,
    whole,
    wide_registers,
)

ROWS = 6  # of a tile: its sums fill the registers
CHUNKS = 3  # vectors of rows that a table alone sums side by side


def multiply(
    code: Code, matrix: Any, own: Any, x: Rows, columns: Any, rows: Any, y: Rows, *, add: bool = False
) -> None:
    """Write (or add) the product of a matrix and the rows x to the rows y.

    Parameters
    ----------
    matrix
        Pointer to (columns, rows), or to (columns, rows, BLOCK) where each table has its own.
    own
        Whether each table has its own, as a whole number.
    x, y
        ``columns`` and ``rows`` rows, which do not overlap; a table alone writes up to the next multiple
        of eight.
    columns, rows
        Whole numbers.
    """
    name = "add_product" if add else "product"
    pieces = [NUMBERS, I64, NUMBERS, I64, I64, NUMBERS]
    emit = _alone if code.block == 1 else _block
    function = code.function(name, pieces, lambda inner, *given: emit(inner, add, *given))
    code.call(function, matrix, own, x.pointer, columns, rows, y.pointer)


def _alone(
    code: Code, add: bool, matrix: Any, own: Any, x: Any, columns: Any, rows: Any, y: Any
) -> None:
    b = code.b
    chunks = b.udiv(b.add(rows, whole(VECTOR - 1)), whole(VECTOR))
    full = b.udiv(chunks, whole(CHUNKS))
    with code.loop(full) as group:
        _chunks(code, add, CHUNKS, matrix, x, columns, rows, y, b.mul(group, whole(CHUNKS * VECTOR)))
    done = b.mul(full, whole(CHUNKS))
    rest, start = b.sub(chunks, done), b.mul(done, whole(VECTOR))
    for count in range(1, CHUNKS):
        with b.if_then(b.icmp_signed("==", rest, whole(count))):
            _chunks(code, add, count, matrix, x, columns, rows, y, start)


def _chunks(
    code: Code, add: bool, count: int, matrix: Any, x: Any, columns: Any, rows: Any, y: Any, start: Any
) -> None:
    """Sum `count` vectors of rows from a row on."""
    b = code.b
    places = [b.add(start, whole(VECTOR * i)) for i in range(count)]
    zero = Rows(code, y)  # of no meaning but for its type
    sums = []
    for place in places:
        begin = code.load(zero.pointer, place, VECTOR)
        if not add:
            begin = code.value(ir.Constant(begin.ir.type, [0.0] * VECTOR))
        sums.append(code.variable(begin))
    with code.loop(columns) as j:
        value = code.load(x, j, 1)
        offset = b.mul(j, rows)
        for place, total in zip(places, sums, strict=True):
            column = code.load(matrix, b.add(offset, place), VECTOR)
            total.set(column.times_plus(value, total.get()))
    for place, total in zip(places, sums, strict=True):
        code.store(y, place, total.get())


def _block(
    code: Code, add: bool, matrix: Any, own: Any, x: Any, columns: Any, rows: Any, y: Any
) -> None:
    b = code.b
    full = b.udiv(rows, whole(ROWS))
    done = b.mul(full, whole(ROWS))
    rest = b.sub(rows, done)
    with b.if_else(code.positive(own)) as (each, common):
        for branch, separate in ((each, True), (common, False)):
            with branch:
                with code.loop(full) as tile:
                    start = b.mul(tile, whole(ROWS))
                    _tile(code, add, separate, ROWS, matrix, x, columns, rows, y, start)
                for count in range(1, ROWS):
                    with b.if_then(b.icmp_signed("==", rest, whole(count))):
                        _tile(code, add, separate, count, matrix, x, columns, rows, y, done)


def _tile(
    code: Code,
    add: bool,
    own: bool,
    count: int,
    matrix: Any,
    x: Any,
    columns: Any,
    rows: Any,
    y: Any,
    start: Any,
) -> None:
    """Sum `count` rows from a row on."""
    b, taken, given = code.b, Rows(code, x), Rows(code, y)
    vectors = code.block // VECTOR if wide_registers() and not own else 1
    with code.loop(code.block // (VECTOR * vectors)) as turn:
        lanes = [
            b.mul(b.add(b.mul(turn, whole(vectors)), whole(v)), whole(VECTOR)) for v in range(vectors)
        ]
        sums: list[list[Variable]] = []
        for r in range(count):
            row = b.add(start, whole(r))
            begins = [given.get(row, lane) if add else code.zero() for lane in lanes]
            sums.append([code.variable(begin) for begin in begins])
        with code.loop(columns) as j:
            values = [taken.get(j, lane) for lane in lanes]
            offset = b.add(b.mul(j, rows), start)
            for r in range(count):
                place = b.add(offset, whole(r))
                if own:
                    factor = Rows(code, matrix).get(place, lanes[0])
                else:
                    factor = values[0].like(code.load(matrix, place, 1))
                for v in range(vectors):
                    sums[r][v].set(values[v].times_plus(factor, sums[r][v].get()))
        for r in range(count):
            for v in range(vectors):
                given.put(b.add(start, whole(r)), lanes[v], sums[r][v].get())
