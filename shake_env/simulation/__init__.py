"""N tables in their episodes: transition, excitation, sensors, metrics."""

from shake_env.simulation.engine import StepResult
from shake_env.simulation.excitation import Excitation
from shake_env.simulation.memory import check_memory
from shake_env.simulation.metrics import EpisodeMetrics, MetricAccumulator
from shake_env.simulation.sensors import Measurement, SensorMemory
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream, episode_stream
from shake_env.simulation.trajectory import Recorder, Trajectory
from shake_env.simulation.transition import TableModel, dynamics_of

__all__ = [
    "EpisodeMetrics",
    "Excitation",
    "Measurement",
    "MetricAccumulator",
    "Recorder",
    "SensorMemory",
    "Simulation",
    "StepResult",
    "TableModel",
    "Trajectory",
    "check_memory",
    "dynamics_of",
    "earthquake_stream",
    "episode_stream",
]
