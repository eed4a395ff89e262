"""Periods of the ground: the motions of five lanes, and what an excitation makes of them."""

import numpy as np

from shake_env import Envelope, FilteredNoise, RecordedMotion
from shake_env.model.random_numbers import episode_key

PARTS = ("ground", "reference", "target", "reference_shear")


MOTIONS = [
    FilteredNoise(duration=30.0),
    RecordedMotion(record="napa2014_68150_hne"),
    FilteredNoise(duration=30.0, amplitude=0.3, envelope=Envelope(rise=0.5, hold=0.4, decay_rate=2.0)),
    RecordedMotion(record="ridgecrest2019_ccc_90", amplitude=2.0, time_compression=2.0),
    FilteredNoise(duration=30.0, envelope=Envelope(rise=0.0, hold=1.0)),
]


def keys(*seeds):
    return [episode_key(np.random.default_rng(seed)) for seed in seeds]


def joined(periods):
    """Stack copies of periods (already copied) by part: (steps, lanes, ...)."""
    return {part: np.stack([p[part] for p in periods]) for part in PARTS}


def taken(excitation):
    period = excitation.advance()
    return {part: getattr(period, part).copy() for part in PARTS}
