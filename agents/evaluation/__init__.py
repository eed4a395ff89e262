"""Controllers on the same earthquakes: comparison, protocol, robustness, statistics."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "benchmark": (
            "bench",
            "difference",
            "result_file",
        ),
        "bootstrap": (
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
        "protocol": (
            "Contestant",
            "contestant",
            "evaluate",
            "optimal_cost",
        ),
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
            "controllers_of",
        ),
    },
)
