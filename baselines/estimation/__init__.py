"""Kalman filters, LQG, adaptive control: from measured signals to the state."""

from baselines.estimation.adaptive import certainty_equivalence
from baselines.estimation.estimator_model import ModelError
from baselines.estimation.lqg import EstimatedState, estimated

__all__ = [
    "EstimatedState",
    "ModelError",
    "certainty_equivalence",
    "estimated",
]
