"""One training run: configuration, checkpoints, exact resumption, export."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "algorithm_options": (
            "APGOptions",
            "PPOOptions",
            "RecurrentPPOOptions",
            "SACOptions",
            "TD3Options",
            "TQCOptions",
        ),
        "checkpoint": (
            "checkpoint_steps",
            "checkpoints",
            "delete_checkpoints",
        ),
        "config": (
            "TrainConfig",
            "config_of",
            "read_config",
            "require_same",
        ),
        "model_factory": ("new_model",),
        "progress": ("TrainingView",),
        "run": (
            "is_finished",
            "train_or_resume",
            "require_beginnable",
            "resume",
            "train",
        ),
    },
)
