"""One control period of the ground under a block: random numbers, filter, reference specimen, target.

Beside :mod:`shake_env.simulation.excitation`, and equal to it to rounding. The periods that a preview
reaches lie ahead in a ring of slots; without a preview it has one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from shake_env.kernels.normals import draw
from shake_env.kernels.parts import slip_rates
from shake_env.kernels.products import multiply
from shake_env.kernels.vectors import F64, I64, NUMBERS, Code, Rows, Value, whole
from shake_env.model.random_numbers import A_BLOCK, GROUND


@dataclass(frozen=True)
class Block:
    """A block of tables: where its record, matrices and room lie."""

    code: Code
    record: Rows
    matrices: Any  # pointer
    room: Rows

    def rows(self, name: str) -> Rows:
        """Return the rows of a field."""
        return self.record.at(self.code.whole(f"row_{name}"))

    def space(self, name: str) -> Rows:
        """Return rows to work in."""
        return self.room.at(self.code.whole(f"room_{name}"))

    def slot(self, number: Any) -> Rows:
        """Return the rows of a slot of the ring."""
        return self.rows("ring").at(self.code.b.mul(number, self.code.whole("stride")))

    def multiply(
        self, name: str, x: Rows, columns: Any, rows: Any, y: Rows, *, add: bool = False
    ) -> None:
        """Write or add the product of one of the block's matrices."""
        code = self.code
        matrix = code.b.gep(self.matrices, [code.whole(f"matrix_{name}")])
        multiply(code, matrix, code.whole("own"), x, columns, rows, y, add=add)

    @property
    def pointers(self) -> tuple[Any, Any, Any]:
        """What stands for the block in a call."""
        return self.record.pointer, self.matrices, self.room.pointer


BLOCK_POINTERS = [NUMBERS, NUMBERS, NUMBERS]


def the_block(code: Code, record: Any, matrices: Any, room: Any) -> Block:
    """Return the block that a called function was given."""
    return Block(code, Rows(code, record), matrices, Rows(code, room))


def copy(code: Code, source: Rows, target: Rows, count: Any) -> None:
    """Copy rows."""
    with code.loop(count) as i, code.lanes() as lane:
        target.put(i, lane, source.get(i, lane))


def advance_ground(block: Block, previous: Any, following: Any) -> None:
    """Write the ground of the next period to a slot, from that of the slot before."""
    function = block.code.function("ground", [*BLOCK_POINTERS, I64, I64], _advance)
    block.code.call(function, *block.pointers, previous, following)


def _advance(code: Code, record: Any, matrices: Any, room: Any, previous: Any, following: Any) -> None:
    block = the_block(code, record, matrices, room)
    b, before, slot = code.b, block.slot(previous), block.slot(following)
    ground, reference = code.whole("filter"), code.whole("reference")
    exogenous = b.add(ground, reference)
    x, samples = block.space("x"), block.space("samples")
    copy(code, before, x, exogenous)
    some, all_of_them = code.variable(code.zero() > 1.0), code.variable(code.zero() < 1.0)
    with code.lanes() as lane:
        recorded = block.rows("recorded").get(0, lane, I64) > 0
        some.set(Value(b, b.or_(some.get().ir, recorded.ir)))
        all_of_them.set(Value(b, b.and_(all_of_them.get().ir, recorded.ir)))
    with b.if_then(some.get().any()):
        # The reference behind the samples: the products may write to the slot that it was read from.
        _gather(block, samples, b.add(exogenous, b.add(code.whole("substeps"), whole(1))), records=True)
        copy(code, x.at(ground), samples.at(ground), reference)
    with b.if_then((~all_of_them.get()).any()):
        _noise(block, x, exogenous, slot)
    with b.if_then(some.get().any()):
        _records(block, samples, slot)
    with b.if_then(code.positive(code.whole("yielding"))):
        _yielding(block, x, slot)
    with code.lanes() as lane:
        period = block.rows("period")
        period.put(0, lane, period.get(0, lane, I64) + 1)


def _noise(block: Block, x: Rows, exogenous: Any, slot: Rows) -> None:
    """Draw, shape and filter."""
    code, b = block.code, block.code.b
    draws, rank, k = code.whole("draws"), code.whole("rank"), code.whole("substeps")
    drawn = x.at(exogenous)
    blocks = b.udiv(b.add(draws, whole(A_BLOCK - 1)), whole(A_BLOCK))
    draw(code, block.rows("key"), block.rows("period"), whole(0), GROUND, blocks, drawn)
    shaped = code.variable(code.zero() > 1.0)
    with code.lanes() as lane:
        shape = block.rows("shape").get(0, lane, I64)
        shaped.set(Value(b, b.or_(shaped.get().ir, (~shape.equals(1)).ir)))
    with b.if_then(shaped.get().any()):
        intensity = block.space("y")
        _gather(block, intensity, k, records=False)
        with code.loop(k) as j, code.loop(rank) as i, code.lanes() as lane:
            row = b.add(b.mul(j, rank), i)
            drawn.put(row, lane, drawn.get(row, lane) * intensity.get(j, lane))
    with code.loop(draws) as i, code.lanes() as lane:
        drawn.put(i, lane, drawn.get(i, lane) * block.rows("amplitude").get(0, lane))
    block.multiply("noise_map", x, b.add(exogenous, draws), code.whole("width"), slot)


def _gather(block: Block, out: Rows, count: Any, *, records: bool) -> None:
    """Write each table's row of its motion's history or envelope.

    A row of a history is the filter state at the period's end, room for the reference, and k + 1
    targets; of an envelope, k intensities. Tables of the other kind take the row that stands for none.
    """
    code, b = block.code, block.code.b
    with code.loop(code.block) as lane:
        as_whole = b.bitcast(block.record.pointer, I64.as_pointer())

        def lanes_own(name: str, lane: Any = lane, rows: Any = as_whole) -> Any:
            place = b.add(b.mul(code.whole(f"row_{name}"), whole(code.block)), lane)
            return b.load(b.gep(rows, [place]))

        kind = b.icmp_signed("==", lanes_own("recorded"), whole(int(records)))
        shape = b.select(kind, lanes_own("shape"), whole(0 if records else 1))
        entry = b.gep(code.pointer("shapes", I64), [b.mul(shape, whole(2))])
        last = b.sub(b.load(b.gep(entry, [whole(1)])), whole(1))
        period = lanes_own("period")
        period = b.select(b.icmp_signed("<", period, last), period, last)
        start = b.inttoptr(b.load(entry), F64.as_pointer())
        with code.loop(count) as i:
            value = b.load(b.gep(start, [b.add(b.mul(period, count), i)]))
            b.store(value, b.gep(out.pointer, [b.add(b.mul(i, whole(code.block)), lane)]))


def _records(block: Block, samples: Rows, slot: Rows) -> None:
    """Put the ground of recorded motions in the place of the noise's."""
    code, b = block.code, block.code.b
    ground, reference, k = code.whole("filter"), code.whole("reference"), code.whole("substeps")
    targets, result = b.add(ground, reference), block.space("y")
    columns = b.add(reference, b.add(k, whole(1)))
    rows = b.add(reference, b.add(k, code.whole("drive")))
    block.multiply("record_map", samples.at(ground), columns, rows, result)

    def put(count: Any, source: Rows, target: Rows) -> None:
        with code.loop(count) as i, code.lanes() as lane:
            recorded = block.rows("recorded").get(0, lane, I64) > 0
            target.put(i, lane, recorded.choose(source.get(i, lane), target.get(i, lane)))

    put(ground, samples, slot)
    put(reference, result, slot.at(ground))
    put(k, samples.at(b.add(targets, whole(1))), slot.at(targets))
    put(b.add(k, code.whole("drive")), result.at(reference), slot.at(b.add(targets, k)))


def _yielding(block: Block, x: Rows, slot: Rows) -> None:
    """Put a yielding reference in the place of the linear one; see `YieldingReference.run`."""
    code, b = block.code, block.code.b
    stories, k = code.whole("stories"), code.whole("substeps")
    order, ground = b.mul(stories, whole(3)), code.whole("filter")
    target = b.add(ground, code.whole("reference"))
    y, later, shear = block.space("y"), block.space("later"), block.space("outputs")
    now, rates = x.at(order), x.at(b.add(order, whole(2)))
    copy(code, block.rows("slipping"), x, order)
    copy(code, block.rows("last_target"), now, whole(1))
    slip_rates(code, x, rates)
    with code.loop(k) as j:
        copy(code, slot.at(b.add(target, j)), now.at(1), whole(1))
        block.multiply("yield_step", x, b.add(order, b.add(stories, whole(2))), order, y)
        slip_rates(code, y, later)
        with code.loop(stories) as i, code.lanes() as lane:
            later.put(i, lane, later.get(i, lane) - rates.get(i, lane))
        block.multiply("yield_change", later, stories, order, y, add=True)
        copy(code, y, x, order)
        copy(code, now.at(1), now, whole(1))
        slip_rates(code, x, rates)
        block.multiply("yield_shear", x, order, whole(1), shear)
        copy(code, shear, slot.at(b.add(target, b.add(k, j))), whole(1))
    copy(code, x, block.rows("slipping"), order)
    copy(code, now, block.rows("last_target"), whole(1))
    copy(code, x, slot.at(ground), code.whole("reference"))
