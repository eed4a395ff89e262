"""What Stable-Baselines3 learns on: environments, features, networks."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "features": (
            "LinearFeatures",
            "feature_matrix",
            "feature_sizes",
        ),
        "memory_policies": (
            "GRUPolicy",
            "MemoryPolicy",
            "TCNPolicy",
        ),
        "networks": (
            "DirectActor",
            "DirectPolicy",
            "LSTMPolicy",
            "ScaleFreeDirectPolicy",
            "ScaleFreePolicy",
        ),
        "paired": ("PairedVecEnv",),
        "plan_wrappers": (
            "PlanVectorWrapper",
            "PlanWrapper",
        ),
        "sb3_env": (
            "SB3Controller",
            "compare_with_reference",
            "make_sb3_env",
        ),
        "training_scenario": (
            "make_training_scenario",
            "reward_scale",
        ),
        "vec_env": ("ShakeTableVecEnv",),
        "wrappers": (
            "TrackingFeatures",
            "TrainingWrapper",
        ),
    },
)
