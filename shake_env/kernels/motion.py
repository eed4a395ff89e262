"""One control period of the table itself over a block: state and response under a current.

Beside :mod:`shake_env.dynamics.linear` and :mod:`shake_env.dynamics.nonlinear`, and equal to them to
rounding.
"""

from __future__ import annotations

from typing import Any

from shake_env.kernels.ground import BLOCK_POINTERS, Block, copy, the_block
from shake_env.kernels.parts import nonlinear
from shake_env.kernels.vectors import Code, Rows, whole
from shake_env.model.plant import SPOOL_POSITION


def move(block: Block, now: Rows) -> None:
    """Write state and response, from the record's state and current and the ground `now`."""
    code, b = block.code, block.code.b
    with b.if_else(code.positive(code.whole("lifted"))) as (linear, stepped):
        with linear:
            _lifted(block, now)
        with stepped:
            code.call(code.function("follow", BLOCK_POINTERS, _follow), *block.pointers)
    with b.if_then(code.positive(code.whole("storeys_seen"))):
        columns, rows = code.whole("floor_columns"), code.whole("storeys_seen")
        block.multiply("floor_map", block.rows("state").at(4), columns, rows, block.space("y"))
        copy(code, block.space("y"), block.rows("floors"), rows)


def _lifted(block: Block, now: Rows) -> None:
    """Advance a linear table by its one matrix."""
    code, b = block.code, block.code.b
    order, k, y = code.whole("order"), code.whole("substeps"), block.space("y")
    drive, rows = code.whole("drive"), b.add(order, b.add(k, k))
    block.multiply("advance", block.rows("state"), b.add(order, whole(1)), rows, y)
    pushed = now.at(b.sub(code.whole("width"), drive))
    with code.loop(drive) as i, code.lanes() as lane:
        y.put(i, lane, y.get(i, lane) + pushed.get(i, lane))
    copy(code, y, block.rows("state"), order)
    copy(code, y.at(order), block.rows("response"), b.add(k, k))


def _follow(code: Code, record: Any, matrices: Any, room: Any) -> None:
    """Advance a table with nonlinear parts; see `NonlinearDynamics.control_step`."""
    block = the_block(code, record, matrices, room)
    b, order, k = code.b, code.whole("order"), code.whole("substeps")
    commands, columns = code.whole("commands"), code.whole("columns")
    state, response = block.rows("state"), block.rows("response")
    x, y, later = block.space("x"), block.space("y"), block.space("later")
    arriving, sampled = block.space("arriving"), block.space("outputs")
    current, g = x.at(order), x.at(b.add(order, whole(1)))
    tall = b.add(order, b.add(columns, whole(1)))
    # The commands under way lie before the present one.
    block.multiply("arrival", state.at(order), b.add(commands, whole(1)), k, arriving)
    with code.loop(commands) as i, code.lanes() as lane:
        row = b.add(order, i)
        state.put(row, lane, state.get(b.add(row, whole(1)), lane))
    copy(code, state, x, order)
    copy(code, arriving, current, whole(1))
    nonlinear(code, block.record, x, current, g)
    with code.loop(k) as j:
        block.multiply("advance", x, tall, order, y)
        nonlinear(code, block.record, y, current, later)
        with code.loop(columns) as i, code.lanes() as lane:
            later.put(i, lane, later.get(i, lane) - g.get(i, lane))
        block.multiply("change", later, columns, order, y, add=True)
        limit = code.scalar("spool_limit")
        with code.lanes() as lane:
            y.put(SPOOL_POSITION, lane, y.get(SPOOL_POSITION, lane).within(limit))
        copy(code, y, x, order)
        # Of g the outputs see the force only, which does not depend on the current: what is computed for
        # them also begins the next step.
        last = b.icmp_signed("==", j, b.sub(k, whole(1)))
        copy(code, arriving.at(b.select(last, j, b.add(j, whole(1)))), current, whole(1))
        nonlinear(code, block.record, x, current, g)
        block.multiply("outputs", x, tall, whole(2), sampled)
        with code.lanes() as lane:
            response.put(j, lane, sampled.get(0, lane))
            response.put(b.add(k, j), lane, sampled.get(1, lane))
    copy(code, x, state, order)
