"""How often the intervals of a forecast hold the outcome of a test drawn from the same belief."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.laboratory.forecasting.forecast import forecast
from agents.laboratory.forecasting.quantities import UNITS
from agents.seeds import COVERAGE_SEED, FORECAST_SEED
from shake_env.model.parameters import FloatArray
from shake_env.scenario.scenario import Scenario


def forecast_coverage(
    scenario: Scenario,
    controller: str,
    *,
    shakes: int,
    samples: int = 500,
    probability: float = 0.9,
    seed: int = 0,
) -> dict[str, Any]:
    """Return the share of tests within the intervals of their forecast, by quantity.

    Parameters
    ----------
    scenario
        Test whose uncertainty is the belief.
    controller
        Name of the one that drives.
    shakes
        Number of tests, each on a plant and noise of its own.
    samples, probability
        Of the forecast.
    seed
        Of the first sample.
    """
    predicted, tested = (
        forecast(
            scenario,
            (controller,),
            samples=number,
            probability=probability,
            seed=first + seed,
        )[0].outcomes
        for number, first in ((samples, FORECAST_SEED), (shakes, COVERAGE_SEED))
    )
    tail = 0.5 - 0.5 * probability
    shares = {}
    for name in (*UNITS, *predicted.measured):
        belief, outcome = ({**each.values, **each.measured}[name] for each in (predicted, tested))
        shares[name] = share_within(belief, outcome, tail)
    return {
        "controller": controller,
        "shakes": shakes,
        "samples": samples,
        "probability": probability,
        "coverage": shares,
        "mean": float(np.mean(list(shares.values()))),
    }


def share_within(belief: FloatArray, outcome: FloatArray, tail: float) -> float:
    """Return the share of outcomes (M,) within the central interval of a belief's samples (N,).

    A bounded quantity has a mass at its bound: the largest current of a test is often the limit itself.
    Where an end of the interval is that value, outcomes at it count by the part of the mass that the
    interval of the stated probability holds (the mean of a randomised rank); counted whole, they would
    give a coverage above it.
    """
    low, high = np.quantile(belief, [tail, 1.0 - tail])
    held = ((outcome > low) & (outcome < high)).astype(float)
    for end in {float(low), float(high)}:
        below, upto = float(np.mean(belief < end)), float(np.mean(belief <= end))
        part = 1.0  # a value of its own: the end is inside
        if upto > below:
            part = max(0.0, min(upto, 1.0 - tail) - max(below, tail)) / (upto - below)
        held[outcome == end] = part
    return float(np.mean(held))
