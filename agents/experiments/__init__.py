"""Many training runs: configurations, runner, searches."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "controller_tuning": (
            "keep_tuned_values",
            "kept_values",
            "tune",
        ),
        "results": ("evaluate_task",),
        "runner": (
            "Campaign",
            "plan_runs",
            "plan_rows",
        ),
        "search": (
            "SearchProgress",
            "find_experiment",
            "search_training",
        ),
        "search_space": ("Search",),
        "search_trace": (
            "Trace",
            "put_searches",
            "read_traces",
            "write_trace",
        ),
    },
)
