"""Policy files and everything that drives a table with one, in numpy; controllers by name."""

from shake_env.lazy import names_of

__getattr__, __all__ = names_of(
    __name__,
    {
        "base_law": ("at_own_cost",),
        "estimated_law": ("EstimatedLaw",),
        "onnx_export": ("export_onnx",),
        "own_controller": (
            "is_own_controller",
            "own_baseline",
            "own_source",
        ),
        "plan_law": (
            "PlanLaw",
            "PlanOptions",
        ),
        "policy_file": (
            "PolicyFile",
            "file_digest",
            "load_policy",
        ),
        "recurrent_cells": (
            "ConvolutionUnit",
            "GatedUnit",
            "LongShortTermUnit",
        ),
        "registry": (
            "ControllerEntry",
            "controllers",
            "find_controller",
            "get_controller",
            "get_driven",
            "policy_path",
            "shipped_policy",
            "values_for",
        ),
        "symmetry": ("mirror_averaged",),
    },
)
