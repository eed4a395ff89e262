"""Controllers of eight measured signals: PID, three-variable control, inverse model, MCS."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "disturbance_observer": (
            "DisturbanceObserver",
            "ObserverDesign",
        ),
        "inverse_model": (
            "InverseDesign",
            "InverseFeedForward",
        ),
        "mcs": (
            "MCS",
            "MCSDesign",
        ),
        "pid": ("PIDRule",),
        "signals": (
            "as_action",
            "recall",
        ),
        "tvc": ("TVCDesign",),
    },
)
