"""What a controller is shown after a control period, over a block: sensors, observation, history.

Beside :mod:`shake_env.simulation.sensors`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from llvmlite import ir

from shake_env.kernels.ground import BLOCK_POINTERS, Block, copy, the_block
from shake_env.kernels.normals import draw
from shake_env.kernels.parts import WHOLE
from shake_env.kernels.vectors import F32, I64, VECTOR, Code, Rows, Value, Variable, whole
from shake_env.model.random_numbers import A_BLOCK, SENSORS

TURNED = 16  # columns and tables that are turned round in registers


def read(block: Block) -> None:
    """Take the readings at the end of the period; see `Measurement.read`."""
    code = block.code
    with code.b.if_then(code.positive(code.whole("readings"))):
        code.call(code.function("read", BLOCK_POINTERS, _read), *block.pointers)


def draw_readings(block: Block, first: int) -> None:
    """Write the noise of the sensors: a standard normal number for each reading."""
    code, b = block.code, block.code.b
    blocks = b.udiv(b.add(code.whole("readings"), whole(A_BLOCK - 1)), whole(A_BLOCK))
    behind = code.whole("ahead")
    draw(code, block.rows("key"), block.rows("period"), behind, first, blocks, block.rows("noise"))


def _read(code: Code, record: Any, matrices: Any, room: Any) -> None:
    block = the_block(code, record, matrices, room)
    draw_readings(block, SENSORS)
    with code.loop(code.whole("readings")) as i:
        row = code.b.load(code.b.gep(code.pointer("signals", I64), [i]))
        names = ("resolution", "rounded", "reading_scale", "rms")
        resolution, rounded, scale, rms = (code.entry(name, i) for name in names)
        with code.lanes() as lane:
            noise = block.rows("noise").get(i, lane)
            signal = block.record.get(row, lane)
            reading = signal + block.rows("gain").get(i, lane) * signal
            reading = reading + block.rows("bias").get(i, lane) + noise * rms
            steps = reading / resolution
            nearest = (steps.absolute() < WHOLE / 3.0).choose((steps + WHOLE) - WHOLE, steps)
            error = (nearest * resolution - reading) * rounded
            block.rows("reading").put(i, lane, (reading + error) / scale)


def remember(block: Block) -> None:
    """Put this period in front of the history; see `Measurement.remember`."""
    code, b = block.code, block.code.b
    history, entry = code.whole("history"), code.whole("entry")
    past, readings = block.rows("past"), code.whole("readings")
    with b.if_then(code.positive(history)):
        moved = b.sub(history, entry)
        with code.loop(moved) as i, code.lanes() as lane:
            row = b.sub(b.sub(history, whole(1)), i)
            past.put(row, lane, past.get(b.sub(row, entry), lane))
        copy(code, block.rows("reading"), past, readings)
        copy(code, block.rows("action"), past.at(readings), b.sub(entry, readings))


def show(block: Block, index: Any, cursor: Any) -> None:
    """Write the observations of the block's tables, of which the first has this index.

    Each entry is a row of the record over its size; those of the ring lie in the slot of the period that
    they are of.
    """
    block.code.call(
        block.code.function("show", [*BLOCK_POINTERS, I64, I64], _show), *block.pointers, index, cursor
    )


def _show(code: Code, record: Any, matrices: Any, room: Any, index: Any, cursor: Any) -> None:
    block = the_block(code, record, matrices, room)
    b, shown, slots = code.b, code.whole("shown"), code.whole("slots")
    sources = code.pointer("sources", I64)
    look = b.bitcast(block.space("look").pointer, F32.as_pointer())
    seen = b.gep(code.pointer("seen", F32), [b.mul(index, shown)])
    if code.block == 1:
        look = seen
    outside = [code.variable(code.zero() > 1.0) for _ in range(0, code.block, code.wide)]
    bound = code.scalar("observation_bound")
    with code.loop(code.whole("segments")) as segment:
        source = b.gep(sources, [b.mul(segment, whole(5))])
        parts = (b.load(b.gep(source, [whole(part)])) for part in range(5))
        start, count, row, ahead, stride = parts
        slot = _wrapped(b, b.add(cursor, ahead), slots)
        rows = block.record.at(b.add(row, b.mul(slot, stride)))
        if code.block == 1:
            _scaled_alone(code, rows, look, start, count, outside[0])
        else:
            _scaled(code, rows, look, start, count, outside)
    # Only the drifting position, or a table that has just diverged, comes near the bound.
    for v, read in enumerate(outside):
        with b.if_then(read.get().any(), likely=False), code.loop(shown) as i:
            place = b.add(b.mul(i, whole(code.block)), whole(v * code.wide))
            value, most = code.load(look, place), bound.to(F32)
            bounded = value.within(most)
            code.store(look, place, (value.absolute().beyond(float("inf"))).choose(0.0, bounded))
    if code.block > 1:
        _turn(code, look, seen, shown)


def _scaled(
    code: Code, rows: Rows, look: Any, start: Any, count: Any, outside: Sequence[Variable]
) -> None:
    """Write a segment of a block; note where an entry is beyond its bound."""
    b, bound = code.b, code.scalar("observation_bound")
    with code.loop(count) as j:
        i = b.add(start, j)
        scale = code.entry("inverse_scales", i)
        for v, found in enumerate(outside):
            value = rows.get(j, v * code.wide) * scale
            far = value.absolute().beyond(bound)
            found.set(Value(b, b.or_(found.get().ir, far.ir)))
            place = b.add(b.mul(i, whole(code.block)), whole(v * code.wide))
            code.store(look, place, value.to(F32))


def _scaled_alone(code: Code, rows: Rows, look: Any, start: Any, count: Any, outside: Variable) -> None:
    """Write a segment of a table alone, eight entries at a time; the next one comes over the last."""
    b = code.b
    scales = b.gep(code.pointer("numbers"), [b.add(code.whole("vector_inverse_scales"), start)])
    places = Value(b, ir.Constant(ir.VectorType(I64, VECTOR), list(range(VECTOR))))
    with code.loop(b.udiv(b.add(count, whole(VECTOR - 1)), whole(VECTOR))) as turn:
        j = b.mul(turn, whole(VECTOR))
        value = code.load(rows.pointer, j, VECTOR) * code.load(scales, j, VECTOR)
        meant = places < code.value(b.sub(count, j))
        far = value.absolute().beyond(code.scalar("observation_bound"))
        some = Value(b, b.and_(meant.ir, far.ir)).any()
        outside.set(Value(b, b.or_(outside.get().ir, some)))
        code.store(look, b.add(start, j), value.to(F32))


def _wrapped(b: Any, slot: Any, slots: Any) -> Any:
    """Return a slot's number within the ring, from one below twice their number."""
    return b.select(b.icmp_signed(">=", slot, slots), b.sub(slot, slots), slot)


def _turn(code: Code, look: Any, seen: Any, shown: Any) -> None:
    """Write rows of quantities as rows of tables, 16 columns of 16 tables at a time.

    The last columns of a table are written with what lies behind them, into the next table's first ones,
    which come later. Those of the block's last table are written one by one.
    """
    b = code.b
    chunks = b.udiv(b.add(shown, whole(TURNED - 1)), whole(TURNED))
    last = b.sub(chunks, whole(1))
    for half in range(0, code.block, TURNED):
        with code.loop(chunks) as turn:
            column = b.mul(b.sub(last, turn), whole(TURNED))
            rows = []
            for i in range(TURNED):
                place = b.add(b.mul(b.add(column, whole(i)), whole(code.block)), whole(half))
                rows.append(code.load(look, place, TURNED))
            low = [i // 2 + TURNED * (i % 2) for i in range(TURNED)]
            high = [TURNED // 2 + each for each in low]
            for _ in range(4):
                rows = [
                    rows[i].shuffled(rows[i + TURNED // 2], places)
                    for i in range(TURNED // 2)
                    for places in (low, high)
                ]
            for n, row in enumerate(rows):
                table = half + n
                place = b.add(b.mul(shown, whole(table)), column)
                if table < code.block - 1:
                    code.store(seen, place, row)
                    continue
                whole_chunk = b.icmp_signed("<=", b.add(column, whole(TURNED)), shown)
                with b.if_else(whole_chunk) as (fits, cut):
                    with fits:
                        code.store(seen, place, row)
                    with cut, code.loop(b.sub(shown, column)) as i:
                        at = b.add(b.mul(b.add(column, i), whole(code.block)), whole(table))
                        code.store(seen, b.add(place, i), code.load(look, at, 1))
