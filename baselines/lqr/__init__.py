"""Linear-quadratic designs: sampled, continuous, preview, integral, robust, predictive."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "continuous": (
            "SteadyCoordinates",
            "continuous_lqr",
            "printed_added_weight",
        ),
        "design_states": (
            "DesignStates",
            "observable_states",
        ),
        "feedforward": ("FeedforwardLQR",),
        "h_infinity": ("robust_feedback",),
        "integral": (
            "DisplacementWeights",
            "IntegralFeedback",
            "lqr_integral",
        ),
        "mpc": (
            "MPCSettings",
            "PredictiveControl",
        ),
        "multi_model": (
            "drawn_models",
            "multi_model_lqr",
        ),
        "preview": (
            "PreviewFeedback",
            "preview_lqr",
            "with_preview",
        ),
        "sampled": (
            "LinearFeedback",
            "ScaledProblem",
            "action_row",
            "lqr",
            "riccati",
            "sampled_lqr",
            "stationary_performance",
        ),
    },
)
