"""Target motions as values, and the processing of recorded ones."""

from shake_env.motion.processing import (
    TableCapacity,
    TableFit,
    filtered,
    fit_amplitude,
    fit_time,
    remove_baseline,
    resampled,
)
from shake_env.motion.targets import (
    Envelope,
    FilteredNoise,
    MotionSet,
    RecordedMotion,
    TargetHistory,
    resample,
    target_history,
)

__all__ = [
    "Envelope",
    "FilteredNoise",
    "MotionSet",
    "RecordedMotion",
    "TableCapacity",
    "TableFit",
    "TargetHistory",
    "filtered",
    "fit_amplitude",
    "fit_time",
    "remove_baseline",
    "resample",
    "resampled",
    "target_history",
]
