"""How often the intervals of a forecast hold the outcome of a test drawn from the same belief."""

from __future__ import annotations

from typing import Any

import numpy as np

from agents.laboratory.forecasting.forecast import forecast
from agents.laboratory.forecasting.quantities import UNITS
from agents.seeds import COVERAGE_SEED, FORECAST_SEED
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
        low, high = np.quantile(belief, [tail, 1.0 - tail])
        shares[name] = float(np.mean((outcome >= low) & (outcome <= high)))
    return {
        "controller": controller,
        "shakes": shakes,
        "samples": samples,
        "probability": probability,
        "coverage": shares,
        "mean": float(np.mean(list(shares.values()))),
    }
