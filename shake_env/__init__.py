"""Shake tables under control: physics, motions and the Gymnasium environment.

Importing this package registers ``ShakeTable-v0``, so that
``gymnasium.make("shake_env:ShakeTable-v0")`` needs no other line.
"""

from gymnasium.envs.registration import register

from shake_env.controller import Controller, NoControl
from shake_env.env import ShakeTableEnv
from shake_env.errors import ShakeError
from shake_env.limits import Limits
from shake_env.motion import Envelope, FilteredNoise, Motion, RecordedMotion
from shake_env.nonlinearity import Friction, Nonlinearity, ServoValve, StrokeStops, Yielding
from shake_env.objective import Objective
from shake_env.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.records import RECORD_NAMES, Record, load_record, read_motion, write_record
from shake_env.scenario import Scenario, make_scenario
from shake_env.uncertainty import Uncertainty, Uniform
from shake_env.vector_env import ShakeTableVectorEnv

register(
    id="ShakeTable-v0",
    entry_point="shake_env.env:ShakeTableEnv",
    vector_entry_point="shake_env.vector_env:ShakeTableVectorEnv",
)

__version__ = "0.1.0"

__all__ = [
    "RECORD_NAMES",
    "Actuator",
    "Controller",
    "Envelope",
    "FilteredNoise",
    "Friction",
    "GroundFilter",
    "Limits",
    "ModelEquations",
    "Motion",
    "NoControl",
    "Nonlinearity",
    "Objective",
    "Record",
    "RecordedMotion",
    "Scenario",
    "ServoValve",
    "ShakeError",
    "ShakeTableEnv",
    "ShakeTableVectorEnv",
    "Specimen",
    "StrokeStops",
    "Uncertainty",
    "Uniform",
    "Yielding",
    "load_record",
    "make_scenario",
    "read_motion",
    "write_record",
]
