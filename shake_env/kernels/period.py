"""One control period of N tables in one compiled call; see :mod:`shake_env.simulation.compiled_engine`.

Imported on first use, where numba is installed. A table alone and tables in blocks have each their own
compiled form of the same source, made when it is first asked for.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from numba import int64, types
from numba.core import cgutils
from numba.core.typing import signature
from numba.extending import intrinsic

from shake_env.kernels.compiling import cached, stamp
from shake_env.kernels.ground import BLOCK_POINTERS, Block, advance_ground, the_block
from shake_env.kernels.judgement import judge
from shake_env.kernels.layout import GROUND, START, STEP
from shake_env.kernels.motion import move
from shake_env.kernels.observing import draw_readings, read, remember, show
from shake_env.kernels.vectors import BLOCK, I64, TABLE, Code, whole
from shake_env.model.random_numbers import GAINS, OFFSETS, SENSORS


def _emit(code: Code) -> Any:
    """Write the call: blocks `first` to before `last` of the table, in a mode; return what ended."""
    b, place = code.b, cgutils.alloca_once_value(code.b, whole(0))
    first, last, size = code.whole("first"), code.whole("last"), code.whole("record_size")
    matrices, own = code.pointer("matrices"), code.whole("matrices_size")
    mode = code.whole("mode")
    with code.loop(last, start=first) as number:
        record = b.gep(code.pointer("records"), [b.mul(number, size)])
        pointers = (record, b.gep(matrices, [b.mul(number, own)]), code.pointer("room"))
        for which, emit in ((STEP, _step), (GROUND, _ground), (START, _start)):
            with b.if_then(b.icmp_signed("==", mode, whole(which))):
                kinds = [*BLOCK_POINTERS, I64, I64.as_pointer()]
                code.call(
                    code.function(emit.__name__, kinds, emit),
                    *pointers,
                    b.mul(number, whole(code.block)),
                    place,
                )
    return b.load(place)


def _cursor(block: Block) -> Any:
    """Return the slot of the present period."""
    pointer = block.rows("cursor").pointer
    return block.code.b.load(block.code.b.bitcast(pointer, I64.as_pointer()))


def _slot(block: Block, cursor: Any, ahead: Any) -> Any:
    """Return the slot that lies `ahead`, at most their number, of another."""
    b, slots = block.code.b, block.code.whole("slots")
    slot = b.add(cursor, ahead)
    return b.select(b.icmp_signed(">=", slot, slots), b.sub(slot, slots), slot)


def _to_next_period(block: Block) -> Any:
    """Compute the ground of one more period, and make the next one the present; return its slot."""
    code, b = block.code, block.code.b
    cursor = _cursor(block)
    # The slot of the period that is over takes the one that lies furthest ahead.
    advance_ground(block, _slot(block, cursor, code.whole("ahead")), cursor)
    following = _slot(block, cursor, whole(1))
    pointer = b.bitcast(block.rows("cursor").pointer, I64.as_pointer())
    with code.loop(code.block) as lane:
        b.store(following, b.gep(pointer, [lane]))
    return following


def _ground(code: Code, record: Any, matrices: Any, room: Any, index: Any, happened: Any) -> None:
    """Advance the ground alone, with the numbers of the readings' noise."""
    block = the_block(code, record, matrices, room)
    _to_next_period(block)
    with code.b.if_then(code.positive(code.whole("readings"))):
        draw_readings(block, SENSORS)


def _step(code: Code, record: Any, matrices: Any, room: Any, index: Any, happened: Any) -> None:
    """Advance by one control period under the actions given."""
    block = the_block(code, record, matrices, room)
    cursor = _to_next_period(block)
    now, given = block.slot(cursor), code.pointer("given")
    with code.lanes() as lane:
        action = code.load(given, code.b.add(index, lane)).within(code.zero() + 1.0)
        block.rows("action").put(0, lane, action)
        block.rows("current").put(0, lane, action * code.scalar("current_limit"))
    move(block, now)
    judge(block, now, index, happened)
    read(block)
    show(block, index, cursor)
    remember(block)


def _start(code: Code, record: Any, matrices: Any, room: Any, index: Any, happened: Any) -> None:
    """Show tables at rest, once the ground that a preview shows is computed.

    The slot of the present period holds the ground at time 0.
    """
    block = the_block(code, record, matrices, room)
    cursor = _cursor(block)
    with code.loop(code.whole("ahead")) as i:
        before = _slot(block, cursor, i)
        advance_ground(block, before, _slot(block, before, whole(1)))
    with code.b.if_then(code.positive(code.whole("readings"))):
        for first, field, size in ((OFFSETS, "bias", "offset"), (GAINS, "gain", "gain_error")):
            draw_readings(block, first)
            with code.loop(code.whole("readings")) as i, code.lanes() as lane:
                drawn = block.rows("noise").get(i, lane) * code.entry(size, i)
                block.rows(field).put(i, lane, drawn)
    read(block)
    show(block, index, cursor)
    remember(block)


def _intrinsic(block: int) -> Any:
    def call(_context: Any, address: Any) -> Any:
        def generate(_target: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
            return _emit(Code(builder, block, builder.inttoptr(arguments[0], TABLE)))

        return signature(types.int64, address), generate

    return intrinsic(call)


# By names of the module, so that what numba keeps on disk does not depend on the process.
_alone, _blocks = _intrinsic(1), _intrinsic(BLOCK)


@lru_cache(maxsize=2)
def period_of(block: int) -> Callable[[int], int]:
    """Return what advances tables in blocks of 1 or BLOCK: a function of the address of their table.

    Returns bits of TERMINATED and TRUNCATED, where any table's episode ended.
    """
    number = stamp()

    def alone(address: int) -> int:
        return _alone(address) if number else 0

    def blocks(address: int) -> int:
        return _blocks(address) if number else 0

    compiled: Callable[[int], int] = cached(int64(int64), alone if block == 1 else blocks)
    return compiled
