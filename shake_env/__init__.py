"""Shake tables under control: physics, motions and the Gymnasium environment.

Importing this package registers ``ShakeTable-v0``, so that
``gymnasium.make("shake_env:ShakeTable-v0")`` needs no other line, and an id for each named scenario,
such as ``ShakeTable-laboratory-v0``.
"""

from gymnasium.envs.registration import register

from shake_env.controller import Controller, NoControl
from shake_env.env import ShakeTableEnv
from shake_env.errors import ShakeError
from shake_env.model.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.model.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.motion.targets import Envelope, FilteredNoise, Motion, MotionSet, RecordedMotion
from shake_env.records import RECORD_NAMES, Record, load_record, read_motion, write_record
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.limits import Limits
from shake_env.scenario.objective import Objective
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.sequence_env import ShakeTableSequenceEnv
from shake_env.vector_env import ShakeTableVectorEnv

# ShakeTable-v0 takes the scenario as an argument; each named one also has an id of its own.
_IDS: dict[str, dict[str, str]] = {"ShakeTable-v0": {}} | {
    f"ShakeTable-{name}-v0": {"scenario": name} for name in NAMED
}
for _id, _arguments in _IDS.items():
    register(
        id=_id,
        entry_point="shake_env.env:ShakeTableEnv",
        vector_entry_point="shake_env.vector_env:ShakeTableVectorEnv",
        kwargs=_arguments,
    )
# One episode is a sequence of shakes on one specimen; batches of it step environment by environment.
register(id="ShakeTable-sequence-v0", entry_point="shake_env.sequence_env:ShakeTableSequenceEnv")

__version__ = "0.1.0"
SCENARIO_NAMES = tuple(NAMED)

__all__ = [
    "RECORD_NAMES",
    "SCENARIO_NAMES",
    "Actuator",
    "Controller",
    "Envelope",
    "FilteredNoise",
    "Friction",
    "GroundFilter",
    "Limits",
    "ModelEquations",
    "Motion",
    "MotionSet",
    "NoControl",
    "Nonlinearity",
    "Objective",
    "Record",
    "RecordedMotion",
    "Scenario",
    "Sensing",
    "Sensor",
    "ServoValve",
    "ShakeError",
    "ShakeTableEnv",
    "ShakeTableSequenceEnv",
    "ShakeTableVectorEnv",
    "Specimen",
    "StrokeStops",
    "Supervised",
    "Uncertainty",
    "Uniform",
    "Yielding",
    "load_record",
    "make_scenario",
    "read_motion",
    "write_record",
]
