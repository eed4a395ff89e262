"""Loops of an LQG: streams of lanes, and the LQ problem of a table that knows its delay."""

import math

import numpy as np

from baselines.lqr.design_states import observable_states
from shake_env.model.plant import REFERENCE_CURRENT


def streams(lanes, seed=0):
    return [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(lanes)]


def delayed_problem(scenario):
    """F, G, Q, R, S of ``[x, u_-c ... u_-1]`` under u_0, built from the physics step alone; scaled."""
    discrete, cost, delay = scenario.discrete, scenario.stage_cost, int(scenario.delay)
    k, kept = discrete.substeps, observable_states(discrete.plant)
    scale = discrete.plant.state_scale[kept]
    A = discrete.model.A[np.ix_(kept, kept)] * scale / scale[:, None]
    B = discrete.model.B[kept, 0] * REFERENCE_CURRENT / scale
    C = discrete.model.C[:, kept] * scale
    n, c = len(kept), math.ceil(delay / k)
    running = np.eye(n, n + c + 1)
    Q = np.zeros((n + c + 1, n + c + 1))
    for j in range(k):
        running = A @ running
        running[:, n + c + (j - delay) // k] += B
        for weight, row in ((cost.acceleration, C[0] - C[2]), (cost.force, C[1] - C[3])):
            error = row @ running
            Q += weight * np.outer(error, error) / k
    F = np.zeros((n + c, n + c + 1))
    F[:n] = running
    F[n:, n + 1 :] = np.eye(c)
    Q[-1, -1] += cost.current * REFERENCE_CURRENT**2
    return F[:, :-1], F[:, -1:], Q[:-1, :-1], Q[-1:, -1:], Q[:-1, -1:], kept, scale
