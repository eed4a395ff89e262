"""Optimal current sequences, nonlinear estimation, and control by receding-horizon plans."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "bound": ("OptimalEpisode", "optimal_episodes"),
        "ekf": ("ExtendedKalmanFilter",),
        "model": ("PlanningModel",),
        "nonlinear_estimate": ("NonlinearEstimate",),
        "nmpc": ("NMPCSettings", "NonlinearPredictiveControl"),
        "planned": ("PlannedControl", "RecordPlan", "plan_records"),
    },
)
