"""Seeds of earthquakes by purpose (docs/protocol.md). Ranges of different purposes never overlap.

A seed fixes the ground motion, the specimen and table drawn for it, and the noise of every sensor.
"""

from __future__ import annotations

from shake_env.errors import ParameterError

RUN_SEEDS = 100_000  # run s trains on seeds from s times that
MOST_RUNS = 10  # runs have seeds 0 to 9, so that training stays below the next range
EVALUATION_SEED = 1_000_000  # evaluation during training
COMPARISON_SEED = 2_000_000  # `shake compare`, `shake design`
# `shake tune`, choice of training configurations, `shake validate-transients`, `shake gradient-noise`,
# `shake adaptation`
VALIDATION_SEED = 3_000_000
TEST_SEED = 4_000_000  # `shake evaluate`, `shake benchmark`, the experiment's evaluation
ROBUSTNESS_SEED = 5_000_000  # `shake robustness`
FORECAST_SEED = 7_000_000  # samples of `shake forecast`
SHAKE_SEEDS = 10_000  # shake n of `shake sequence` is forecast with seeds from n times that on
COVERAGE_SEED = 8_000_000  # tests that `shake calibrate --shakes` holds against their forecast
LARGEST_SEED = 2**31 - 1  # of an option


def require_seed(seed: int) -> None:
    """Raise ParameterError unless a seed lies between 0 and `LARGEST_SEED`."""
    if not 0 <= seed <= LARGEST_SEED:
        raise ParameterError("seed", seed, f"must not be negative, and at most {LARGEST_SEED}")
