"""Nonlinear parts of the table over a block; see :mod:`shake_env.model.nonlinearity`.

Beside `NonlinearDynamics.nonlinear`, part by part, and equal to it to rounding.
"""

from __future__ import annotations

import math
from typing import Any

from llvmlite import ir

from shake_env.kernels.vectors import F64, I64, NUMBERS, Code, Rows, Value, whole
from shake_env.model.plant import LOAD_PRESSURE, SPOOL_POSITION, TABLE_DISPLACEMENT, TABLE_VELOCITY

LOG2_E, LN_2_HIGH, LN_2_LOW = 1.4426950408889634, 6.93147180369123816490e-01, 1.90821492927058770002e-10
WHOLE = 1.5 * 2.0**52  # added and taken off it rounds to a whole number, half to even


def expm1(x: Value) -> Value:
    """Return exp(x) - 1 for x <= 0 to a few units in the last place, without a branch or a call.

    ``x = n ln 2 + r``: the series at r, where thirteen terms reach rounding, then ``2^n (e(r) + 1) -
    1``. Beyond -40 it is -1 to rounding.
    """
    x = (x < -40.0).choose(-40.0, x)
    shifted = x.times_plus(LOG2_E, WHOLE)
    n = shifted - WHOLE
    r = n.times_plus(-LN_2_LOW, n.times_plus(-LN_2_HIGH, x))
    total = r.like(1.0 / math.factorial(13))
    for i in range(12, 1, -1):
        total = total.times_plus(r, 1.0 / math.factorial(i))
    series = (total * r).times_plus(r, r)
    power = ((shifted.as_bits(I64) << 52) + (1023 << 52)).as_bits(F64)
    return series.times_plus(power, power - 1.0)


def tanh(x: Value) -> Value:
    """Return tanh(x) to a few units in the last place."""
    p = expm1(x.absolute() * -2.0)
    return (-p / (p + 2.0)).signed_as(x)


def nonlinear(code: Code, record: Rows, x: Rows, current: Rows, g: Rows) -> None:
    """Write g, a row for each column that is on, for states x and the current [A]."""
    function = code.function("parts", [NUMBERS] * 4, _nonlinear)
    code.call(function, record.pointer, x.pointer, current.pointer, g.pointer)


def _nonlinear(code: Code, record_at: Any, x_at: Any, current_at: Any, g_at: Any) -> None:
    record, x, current, g = (Rows(code, pointer) for pointer in (record_at, x_at, current_at, g_at))
    b = code.b
    on = {
        name: b.icmp_signed(">=", code.whole(name), whole(0))
        for name in ("flow", "force", "rate", "slips")
    }
    with code.lanes() as lane:
        with b.if_then(on["flow"]):
            g.put(code.whole("flow"), lane, _flow(code, record, x, lane))
        with b.if_then(on["force"]):
            force = code.variable(code.zero())
            with b.if_then(code.positive(code.whole("friction"))):
                force.set(_friction(code, record, x, lane))
            with b.if_then((code.scalar("gap") < math.inf).ir):
                force.set(force.get() - _stops(code, x, lane))
            g.put(code.whole("force"), lane, force.get())
        with b.if_then(on["rate"]):
            rates = code.whole("row_valve")
            free = code.variable(record.get(rates, lane) * x.get(SPOOL_POSITION, lane))
            pushed = record.get(b.add(rates, whole(1)), lane) * current.get(0, lane)
            free.set(free.get() + pushed)
            own = code.whole("spool_velocity")
            with b.if_then(b.icmp_signed(">=", own, whole(0))):
                free.set(x.get(own, lane))
            rate = free.get()
            g.put(code.whole("rate"), lane, rate.within(code.scalar("rate_limit")) - rate)
    with b.if_then(on["slips"]):
        slip_rates(code, x.at(4), g.at(code.whole("slips")))


def _flow(code: Code, record: Rows, x: Rows, lane: Any) -> Value:
    spool, pressure = x.get(SPOOL_POSITION, lane), x.get(LOAD_PRESSURE, lane)
    limited = spool.within(code.scalar("spool_limit"))
    past = limited.absolute() - code.scalar("dead_band")
    opening = (past < 0.0).choose(0.0, past).signed_as(limited)
    short = record.get(code.b.add(code.whole("row_valve"), whole(2)), lane)
    short = short + opening.absolute() * code.scalar("supply_sag")
    load = (opening > 0.0).choose(pressure, pressure * -1.0) + short
    available = 1.0 - load / code.scalar("rated_pressure")
    return opening * (available < 1e-6).choose(1e-6, available).root() - spool


def _friction(code: Code, record: Rows, x: Rows, lane: Any) -> Value:
    velocity = x.get(TABLE_VELOCITY, lane)
    force = code.variable(record.get(code.whole("row_coulomb"), lane))
    with code.b.if_then(code.positive(code.whole("static"))):
        ratio = velocity / code.scalar("stribeck_velocity")
        more = (expm1(ratio * ratio * -1.0) + 1.0) * code.scalar("excess")
        force.set(force.get() + more)
    side = tanh(velocity / code.scalar("smoothing_velocity"))
    return -(force.get() * side + velocity * code.scalar("viscous"))


def _stops(code: Code, x: Rows, lane: Any) -> Value:
    displacement, velocity = x.get(TABLE_DISPLACEMENT, lane), x.get(TABLE_VELOCITY, lane)
    past = displacement.absolute() - code.scalar("gap")
    depth = (past < 0.0).choose(0.0, past)
    outward = (displacement > 0.0).choose(velocity, velocity * -1.0)
    share = depth * 1e3
    damped = outward * code.scalar("damping") * (share > 1.0).choose(1.0, share)
    push = depth * code.scalar("stiffness") + damped
    return (push < 0.0).choose(0.0, push).signed_as(displacement)


def slip_rates(code: Code, floors: Rows, rates: Rows) -> None:
    """Write the slip rates, a row a storey, of ``[x_r, x_r', s]``, three rows a storey."""
    function = code.function("slip_rates", [NUMBERS, NUMBERS], _slip_rates)
    code.call(function, floors.pointer, rates.pointer)


def _slip_rates(code: Code, floors_at: Any, rates_at: Any) -> None:
    b, floors, rates = code.b, Rows(code, floors_at), Rows(code, rates_at)
    stories, exponent = code.whole("stories"), code.scalar("exponent")
    with code.loop(stories) as storey, code.lanes() as lane:
        velocity, slip = b.add(storey, stories), b.add(storey, b.add(stories, stories))
        # Drifts are relative to the table: nothing lies below the first storey.
        first = b.icmp_signed("==", storey, whole(0))
        below = b.select(first, storey, b.sub(storey, whole(1)))
        moving = code.value(b.select(first, ir.Constant(F64, 0.0), ir.Constant(F64, 1.0)))
        drift = floors.get(storey, lane) - floors.get(below, lane) * moving
        z = (drift - floors.get(slip, lane)) / code.scalar("yield_drift")
        rate = floors.get(velocity, lane) - floors.get(b.add(below, stories), lane) * moving
        size = z.absolute()
        size = (size > 1.0).choose(1.0, size)
        power = code.variable(size)
        with b.if_else(code.positive(code.whole("whole_exponent"))) as (repeated, general):
            with repeated, code.loop(b.sub(code.whole("whole_exponent"), whole(1))):
                power.set(power.get() * size)
            with general:
                power.set(size.called("pow", exponent))
        rates.put(storey, lane, (rate * z > 0.0).choose(rate, 0.0) * power.get())
