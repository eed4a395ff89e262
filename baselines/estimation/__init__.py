"""Kalman filters, LQG, adaptive control: from measured signals to the state."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "adaptive": ("certainty_equivalence",),
        "estimator_model": ("ModelError",),
        "lqg": (
            "EstimatedState",
            "estimated",
        ),
    },
)
