"""Cost and limits of a control period over a block, and what it reports.

Beside :class:`shake_env.scenario.objective.StageCost` and :class:`shake_env.scenario.limits.Limits`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from shake_env.kernels.ground import Block
from shake_env.kernels.layout import REPORT, TERMINATED, TRUNCATED
from shake_env.kernels.vectors import F64, I8, I64, Code, Rows, Value, Variable, whole
from shake_env.model.plant import LOAD_PRESSURE, TABLE_DISPLACEMENT, TABLE_VELOCITY

CURRENT_LIMIT, FLOOR_LIMIT = 6, 7  # codes of limits; see limits.REASONS


def judge(block: Block, now: Rows, index: Any, happened: Any) -> None:
    """Write a period's report, rewards and ends, and count it.

    Parameters
    ----------
    block, now
        The block, its state moved, and the ground of this period.
    index
        Number of the block's first table.
    happened
        Place of a whole number: bits of TERMINATED and TRUNCATED are set where any table's episode
        ended.
    """
    code = block.code
    with code.lanes() as lane:
        _judge(block, now, code.b.add(index, lane), lane, happened)


def _judge(block: Block, now: Rows, table: Any, lane: Any, happened: Any) -> None:
    code, b = block.code, block.code.b
    k = code.whole("substeps")
    target = b.add(code.whole("filter"), code.whole("reference"))
    response, state = block.rows("response"), block.rows("state")
    values: dict[str, Value] = {"current": block.rows("current").get(0, lane)}
    for i, (name, ours, theirs) in enumerate(
        (
            ("acceleration", "table_acceleration", "target_acceleration"),
            ("force", "base_shear", "reference_base_shear"),
        )
    ):
        first = b.mul(k, whole(i))
        total, last = code.variable(code.zero()), b.add(first, b.sub(k, whole(1)))
        with code.loop(k) as j:
            row = b.add(first, j)
            error = response.get(row, lane) - now.get(b.add(target, row), lane)
            total.set(total.get() + error * error)
        values[ours], values[theirs] = response.get(last, lane), now.get(b.add(target, last), lane)
        weight = block.rows("weights").get(i, lane)
        mean = total.get() / code.value(b.sitofp(k, F64))
        values[f"{name}_cost"] = weight * mean
    values["current_cost"] = block.rows("weights").get(2, lane) * (values["current"] * values["current"])
    for name, place in (
        ("table_displacement", TABLE_DISPLACEMENT), ("table_velocity", TABLE_VELOCITY),
        ("load_pressure", LOAD_PRESSURE),
    ):  # fmt: skip
        values[name] = state.get(place, lane)
    broken, soft = _limits(block, values, lane)
    values["broken"], values["soft_limit_cost"] = broken, soft
    values["limit_cost"] = _close(block, broken, table, lane, happened)
    stage = values["acceleration_cost"] + values["force_cost"] + values["current_cost"]
    values["reward"] = -(stage + soft + values["limit_cost"])
    report, padded = code.pointer("report"), code.whole("padded")
    for i, name in enumerate(REPORT):
        code.store(report, b.add(b.mul(padded, whole(i)), table), values[name])


def _limits(block: Block, values: dict[str, Value], lane: Any) -> tuple[Value, Value]:
    """Return the code of the first broken limit, 0 where there is none, and what soft limits cost."""
    code, b, state = block.code, block.code.b, block.rows("state")
    outside = code.variable(code.zero() > 1.0)
    with code.loop(code.whole("controlled")) as i:
        # A NaN counts as diverged.
        beyond = state.get(i, lane).absolute().beyond(code.entry("bounds", i))
        outside.set(Value(b, b.or_(outside.get().ir, beyond.ir)))
    codes = code.variable(outside.get().choose(code.zero() + 1.0, code.zero()))
    costs = code.variable(code.zero())
    quantities: tuple[tuple[str, Callable[[], Value]], ...] = (
        ("displacement_limit", lambda: values["table_displacement"].absolute()), ("velocity_limit",
        lambda: values["table_velocity"].absolute()), ("pressure_limit", lambda:
        values["load_pressure"].absolute()), ("acceleration_limit", lambda: _largest(code,
        block.rows("response"), code.whole("substeps"), lane)), ("command_limit", lambda:
        values["current"].absolute()), ("floor_limit", lambda: _largest(code, block.rows("floors"),
        code.whole("storeys_seen"), lane)),
    )  # fmt: skip
    for number, (name, size) in enumerate(quantities, 2):
        limit = code.scalar(name)
        with b.if_then((limit < math.inf).ir):
            _hold(code, size(), limit, number, codes, costs)
    return codes.get(), costs.get()


def _largest(code: Code, rows: Rows, count: Any, lane: Any) -> Value:
    """Return the largest absolute value of rows, NaN if there is one."""
    largest = code.variable(code.zero())
    with code.loop(count) as i:
        value, so_far = rows.get(i, lane).absolute(), largest.get()
        largest.set(value.beyond(so_far).choose(value, so_far))
    return largest.get()


def _hold(code: Code, size: Value, limit: Value, number: int, codes: Variable, costs: Variable) -> None:
    """Hold a quantity against its limit, and price what comes close."""
    # The first limit that broke is the one to be named.
    first = Value(code.b, code.b.and_(codes.get().equals(0.0).ir, (size > limit).ir))
    codes.set(first.choose(float(number), codes.get()))
    if number == CURRENT_LIMIT:  # the stage cost prices it
        return
    weight, share = code.scalar("soft_weight"), code.scalar("soft_share")
    with code.b.if_then((weight > 0.0).ir):
        beyond = (size / limit - share) / (1.0 - share)
        beyond = (beyond < 0.0).choose(0.0, beyond)
        costs.set(costs.get() + beyond * beyond * weight)


def _close(block: Block, broken: Value, table: Any, lane: Any, happened: Any) -> Value:
    """Count the period, write the ends; return what a broken limit costs."""
    code, b = block.code, block.code.b
    padded, counters = code.whole("padded"), code.pointer("counters", I64)
    count = code.load(counters, table) + 1
    code.store(counters, table, count)
    left = code.load(counters, b.add(table, padded)) - count
    terminated = ~broken.equals(0.0)
    truncated = Value(b, b.and_((left <= 0).ir, (~terminated).ir))
    ends = code.pointer("ends", I8)
    for i, (which, bit) in enumerate(((terminated, TERMINATED), (truncated, TRUNCATED))):
        code.store(ends, b.add(b.mul(padded, whole(i)), table), which.to(I8, signed=False))
        with b.if_then(which.any()):
            b.store(b.or_(b.load(happened), whole(bit)), happened)
    price = code.variable(code.zero())
    with b.if_then(terminated.any()):
        remaining = (left > 1).choose(left, 1).to(F64)
        most = code.scalar("limit_steps")
        remaining = (remaining < most).choose(remaining, remaining.like(most))
        cost = block.rows("severity").get(0, lane) * code.scalar("limit_rate") * remaining
        price.set(terminated.choose(cost, 0.0))
    return price.get()
