"""Norms, closed loops, model reduction, python-control."""

from baselines.analysis.balanced_truncation import (
    Reduction,
    gain_curve,
    gramian_factor,
    h_infinity_norm,
    hankel_singular_values,
    order_within,
)
from baselines.analysis.batch_response import mean_squares
from baselines.analysis.closed_loop import ClosedLoop, Response, respond
from baselines.analysis.h2 import h2_frequency, h2_lyapunov, tracking_response
from baselines.analysis.python_control import ControlLaw, driven_to_control, from_control, to_control

__all__ = [
    "ClosedLoop",
    "ControlLaw",
    "Reduction",
    "Response",
    "driven_to_control",
    "from_control",
    "gain_curve",
    "gramian_factor",
    "h2_frequency",
    "h2_lyapunov",
    "h_infinity_norm",
    "hankel_singular_values",
    "mean_squares",
    "order_within",
    "respond",
    "to_control",
    "tracking_response",
]
