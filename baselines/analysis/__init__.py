"""Norms, closed loops, model reduction, python-control."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "balanced_truncation": (
            "Reduction",
            "gain_curve",
            "gramian_factor",
            "h_infinity_norm",
            "hankel_singular_values",
            "order_within",
        ),
        "batch_response": ("mean_squares",),
        "closed_loop": (
            "ContinuousClosedLoop",
            "Response",
            "forced_response",
        ),
        "h2": (
            "h2_frequency",
            "h2_lyapunov",
            "tracking_response",
        ),
        "python_control": (
            "ControlLaw",
            "driven_to_control",
            "from_control",
            "to_control",
        ),
    },
)
