"""Controllers on the same earthquakes: comparison, protocol, robustness, statistics."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "benchmark": (
            "run_benchmark",
            "difference_of_result",
            "result_file",
        ),
        "bound": (
            "bound_of",
            "causal_bound",
            "optimal_cost",
        ),
        "bound_store": (
            "Bounds",
            "earthquake_bounds",
        ),
        "statistics": (
            "cost_ratio",
            "mean_interval",
        ),
        "comparison": ("compare",),
        "controller_set": (
            "describe_values",
            "require_names",
        ),
        "fidelity": (
            "Fidelity",
            "spectrum",
        ),
        "latency": ("decision_time",),
        "entries": (
            "Entry",
            "find_entry",
        ),
        "protocol": ("evaluate",),
        "result_files": (
            "read_result",
            "read_results",
            "write_result",
        ),
        "results": (
            "Comparison",
            "GroupSummary",
            "cost_text",
        ),
        "robustness": (
            "Grid",
            "controllers_with_sources",
        ),
    },
)
