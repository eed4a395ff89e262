"""Drive files, and their correction from test to test."""

from baselines.iterative.drive_file import DriveFile
from baselines.iterative.ilc import norm_optimal_learning
from baselines.iterative.transfer_function_iteration import IterationPlan

__all__ = [
    "DriveFile",
    "IterationPlan",
    "norm_optimal_learning",
]
