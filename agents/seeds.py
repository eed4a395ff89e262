"""Seeds of earthquakes by purpose (docs/protocol.md). Ranges of different purposes never overlap.

A seed fixes the ground motion, the specimen and table drawn for it, and the noise of every sensor.
"""

from __future__ import annotations

RUN_SEEDS = 100_000  # run s trains on seeds from s times that
MOST_RUNS = 10  # runs have seeds 0 to 9, so that training stays below the next range
EVALUATION_SEED = 1_000_000  # evaluation during training
COMPARISON_SEED = 2_000_000  # `shake compare`, `shake design`
VALIDATION_SEED = (
    3_000_000  # `shake tune`, choice of training configurations, `shake validate-transients`
)
TEST_SEED = 4_000_000  # `shake evaluate`, `shake benchmark`, the experiment's evaluation
ROBUSTNESS_SEED = 5_000_000  # `shake robustness`
