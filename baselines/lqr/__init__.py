"""Linear-quadratic designs: sampled, continuous, preview, integral, robust, predictive."""

from baselines.lqr.continuous import SteadyCoordinates, continuous_lqr, printed_added_weight
from baselines.lqr.feedforward import FeedforwardLQR
from baselines.lqr.h_infinity import robust_feedback
from baselines.lqr.integral import DisplacementWeights, IntegralFeedback, lqr_integral
from baselines.lqr.mpc import MPCSettings, PredictiveControl
from baselines.lqr.multi_model import drawn_models, multi_model_lqr
from baselines.lqr.preview import PreviewFeedback, preview_lqr, with_preview
from baselines.lqr.sampled import (
    LinearFeedback,
    ScaledProblem,
    action_row,
    lqr,
    observable_states,
    riccati,
    sampled_lqr,
    stationary_performance,
)

__all__ = [
    "DisplacementWeights",
    "FeedforwardLQR",
    "IntegralFeedback",
    "LinearFeedback",
    "MPCSettings",
    "PredictiveControl",
    "PreviewFeedback",
    "ScaledProblem",
    "SteadyCoordinates",
    "action_row",
    "continuous_lqr",
    "drawn_models",
    "lqr",
    "lqr_integral",
    "multi_model_lqr",
    "observable_states",
    "preview_lqr",
    "printed_added_weight",
    "riccati",
    "robust_feedback",
    "sampled_lqr",
    "stationary_performance",
    "with_preview",
]
