"""Controllers of eight measured signals: PID, three-variable control, inverse model, MCS."""

from baselines.servo.disturbance_observer import DisturbanceObserver, ObserverDesign
from baselines.servo.inverse_model import InverseDesign, InverseFeedForward
from baselines.servo.mcs import MCS, MCSDesign
from baselines.servo.pid import PIDRule
from baselines.servo.signals import as_action, recall
from baselines.servo.tvc import TVCDesign

__all__ = [
    "MCS",
    "DisturbanceObserver",
    "InverseDesign",
    "InverseFeedForward",
    "MCSDesign",
    "ObserverDesign",
    "PIDRule",
    "TVCDesign",
    "as_action",
    "recall",
]
