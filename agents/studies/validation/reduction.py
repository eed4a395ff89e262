"""Balanced reduction of the continuous closed loops: singular values, orders, errors against bounds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines.analysis.balanced_truncation import (
    Match,
    Reduction,
    balanced_truncation,
    gain_curve,
    gramian_factor,
    h_infinity_norm,
    hankel_singular_values,
    order_within,
)
from baselines.analysis.closed_loop import CURRENT, ERRORS, ContinuousClosedLoop
from shake_env.model.parameters import FloatArray
from shake_env.model.plant import StateSpace

TOLERANCE = 2e-3  # bound of the model that is simulated, relative to the closed loop's own norm
MOST_ORDERS = 14  # rows of the table of orders
RUNGE_KUTTA = 2.785  # |pole| * step below which the classical fourth-order method is stable, real pole
METHODS: dict[str, Match] = {"cut": "high", "settled": "low"}
"""Weak states cut off (exact at infinite frequency) or settled at once (exact at frequency zero)."""


@dataclass(frozen=True)
class ReducedLoop:
    """A closed loop, its scaled outputs without the current, and the models reduced from it."""

    loop: ContinuousClosedLoop
    outputs: tuple[str, ...]
    full: StateSpace  # scaled by the loop's sizes
    chosen: dict[str, Reduction]  # by method, at the order that is simulated
    summary: dict[str, Any]  # numbers for the JSON file


def reduce_loop(table: str, loop: ContinuousClosedLoop) -> ReducedLoop:
    """Reduce a closed loop at every order worth a row, and choose the order that is simulated."""
    outputs = tuple(name for name in loop.outputs if name != CURRENT)
    full = loop.scaled(outputs)
    values = hankel_singular_values(full)
    norm, where = h_infinity_norm(full)
    order = order_within(values, TOLERANCE * norm)
    rows = [_row(full, n, norm) for n in _orders(values, order)]
    chosen = {method: balanced_truncation(full, order, match) for method, match in METHODS.items()}
    fastest = float(np.abs(loop.poles[0]))
    reduced_fastest = float(np.max(np.abs(np.linalg.eigvals(chosen["settled"].system.A))))
    reach = gramian_factor(loop.system.A, loop.system.B)
    summary = {
        "table": table,
        "full_order": loop.system.order,
        "h_infinity_norm": norm,
        "h_infinity_frequency": where,
        "order": order,
        "error_bound": chosen["settled"].error_bound,
        "fastest_pole": fastest,
        "slowest_pole": float(np.max(loop.poles.real)),
        "reduced_fastest_pole": reduced_fastest,
        "white_noise_rms_current": float(np.linalg.norm(loop.system.C[loop.index[CURRENT]] @ reach)),
        "largest_stable_step": RUNGE_KUTTA / fastest,
        "reduced_largest_stable_step": RUNGE_KUTTA / reduced_fastest,
        "hankel_singular_values": {
            "errors, over their own size": _values(_over_own_size(loop)),
            "errors, over the target's size": _values(loop.scaled(ERRORS)),
            "states and outputs": values.tolist(),
            "with the current": _values(loop.scaled()),
        },
        "orders": rows,
    }
    return ReducedLoop(loop, outputs, full, chosen, summary)


def _values(system: StateSpace) -> list[float]:
    values: list[float] = hankel_singular_values(system).tolist()
    return values


def _over_own_size(loop: ContinuousClosedLoop) -> StateSpace:
    errors = loop.scaled(ERRORS)
    rows = [StateSpace(errors.A, errors.B, errors.C[[i]], errors.D[[i]]) for i in range(len(ERRORS))]
    own = np.array([h_infinity_norm(row)[0] for row in rows])[:, None]
    return StateSpace(errors.A, errors.B, errors.C / own, errors.D / own)


def _orders(values: FloatArray, chosen: int) -> list[int]:
    """Return the orders with a row: spread up to where rounding begins, and the chosen one."""
    last = int(np.sum(values > 1e-9 * values[0]))
    spread = np.unique(np.linspace(1, last, min(last, MOST_ORDERS)).round().astype(int))
    return sorted({*spread.tolist(), chosen})


def _row(full: StateSpace, order: int, norm: float) -> dict[str, Any]:
    row: dict[str, Any] = {"order": order}
    for method, match in METHODS.items():
        truncation = balanced_truncation(full, order, match)
        row["bound"] = truncation.error_bound / norm
        row[f"error_{method}"] = h_infinity_norm(full, truncation.system)[0] / norm
        row[f"fastest_pole_{method}"] = float(np.max(np.abs(np.linalg.eigvals(truncation.system.A))))
    return row


def error_curves(reduced: ReducedLoop, frequencies: FloatArray) -> dict[str, FloatArray]:
    """Return, over `frequencies` [Hz], |G~_1| and |G~_2| in SI and the gain of the whole difference.

    Keys: ``(model, output)`` as ``"full 0"``, ``"cut 0"``, ``"settled 1"`` and so on for the two errors,
    and ``"difference cut"``, ``"difference settled"`` over all scaled outputs.
    """
    omega = 2.0 * np.pi * frequencies
    models = {"full": reduced.full} | {m: r.system for m, r in reduced.chosen.items()}
    curves = {}
    for name, model in models.items():
        for i in range(len(ERRORS)):
            one = StateSpace(model.A, model.B, model.C[[i]], model.D[[i]])
            curves[f"{name} {i}"] = gain_curve(one, omega) * reduced.loop.sizes[i]
        if name != "full":
            curves[f"difference {name}"] = gain_curve(reduced.full, omega, model)
    return curves
