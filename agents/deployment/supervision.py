"""The safety supervisor as a block around another controller's."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.deployment.program import Block, flat
from shake_env.safety.braking import ACTUATOR
from shake_env.safety.sensor_faults import CHANCE
from shake_env.safety.supervisor import DEVIATIONS, MISFIT, ROUNDING, TRUST, Supervised
from shake_env.safety.table_state_observer import FADING, GATE


def supervisor_block(supervised: Supervised, inner: Block) -> Block:
    """Return a supervisor with the block of the controller that it is put around."""
    observer, prediction = supervised.observer, supervised.prediction
    channels, size = observer.channels, supervised.scenario.observation.size
    h, columns, rows = prediction.rows.shape
    rest = observer.begin(1).covariance[0]
    arrays = {
        "scale": channels.scale,
        # A reading without a bound is bounded by what a double holds, so that no constant is infinite.
        "reach": np.minimum(channels.reach, 1e30),
        "rarity": channels.rarity,
        "size": observer.size,
        "unit": observer.unit,
        "A": observer.A,
        "C": observer.C,
        "R": observer.R,
        "Q": observer.Q,
        "flow": observer.flow,
        "current": observer.current,
        "current_sum": observer.current.sum(axis=1),
        "oil": observer.oil,
        "rest": np.diagonal(rest),
        "usual": 3.0 * observer.usual,
        "rows": np.swapaxes(prediction.rows, 1, 2),
        "bound": prediction.bound[:, 0],
        "velocity": prediction.velocity,
        "push": prediction.push,
        "carry": prediction.carry,
        "feedback": prediction.feedback,
    }
    reading = np.zeros(size, dtype=int)
    reading[channels.places] = 1
    numbers: dict[str, Any] = {
        "n": size,
        "s": len(channels.names),
        "states": len(observer.size),
        "h": h,
        "m": prediction.carry.shape[1],
        "c": len(prediction.feedback) - ACTUATOR,
        "columns": columns,
        "rows_count": rows,
        "rare": -math.log10(CHANCE),
        "gate": GATE,
        "fading": FADING,
        "trust": TRUST,
        "deviations": DEVIATIONS,
        "misfit_share": MISFIT,
        "rounding": ROUNDING,
        "most": supervised.most,
        "limit": supervised.scenario.current_limit,
        "gain_error": observer.gain_error,
        "delay_error": observer.delay_error,
        "flow_active": supervised.scenario.nonlinearity.valve.flow_active,
    }
    return Block(
        "supervisor",
        "safety supervisor: limits the commands so that braking keeps every hard limit",
        {name: flat(array) for name, array in arrays.items()},
        integers={"places": [int(place) for place in channels.places], "is_reading": reading.tolist()},
        numbers=numbers,
        inner=inner,
    )
