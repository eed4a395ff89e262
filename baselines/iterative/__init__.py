"""Drive files, and their correction from test to test."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "drive_file": ("DriveFile",),
        "ilc": ("norm_optimal_learning",),
        "transfer_function_iteration": ("IterationPlan",),
    },
)
