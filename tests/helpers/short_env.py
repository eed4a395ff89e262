"""A short episode and small actions for tests of the environments."""

import numpy as np

SHORT = {"duration": 0.5}


def push(lanes, steps, seed=0, size=0.1):
    rng = np.random.default_rng(seed)
    return rng.uniform(-size, size, (steps, lanes, 1)).astype(np.float32)
