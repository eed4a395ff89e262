"""Random scenarios: every field is changed in some, every kind of motion and sensor occurs."""

import numpy as np

from shake_env import RECORD_NAMES, MotionSet, Record, RecordedMotion, Sensor, Uniform, make_scenario
from shake_env.errors import ShakeError
from shake_env.scenario.builder import with_fields
from shake_env.scenario.observation import UNITS
from shake_env.scenario.presets import NAMED
from shake_env.scenario.scenario_file import flattened
from shake_env.simulation.simulation import Simulation

KEPT = ("physics_step", "control_rate", "sensing.preview", "limits.soft_share", "noise_directions")


def number(stream):
    """A number near 1 with all digits of a double."""
    return float(10.0 ** stream.uniform(-0.15, 0.15))


def random_record(stream):
    points = int(stream.integers(200, 400))
    acceleration = stream.standard_normal(points) * stream.choice([0.1, 1.0])
    attribution = (("event", "made"), ("note", 'with "quotes", # and = signs'))
    return Record(f"made {stream.integers(1000)}", acceleration, 0.01, attribution)


def random_motion(stream):
    kind = stream.integers(4)
    if kind == 3:
        motions = tuple(recorded(stream) for _ in range(int(stream.integers(1, 4))))
        return MotionSet(motions, amplitude=number(stream))
    return recorded(stream) if kind else None


def recorded(stream):
    return RecordedMotion(
        record=random_record(stream) if stream.integers(2) else str(stream.choice(RECORD_NAMES)),
        amplitude=number(stream),
        time_compression=1.0 if stream.integers(4) else number(stream),
        highpass_frequency=None if stream.integers(2) else 0.1 * number(stream),
        lowpass_frequency=None if stream.integers(2) else 20.0 * number(stream),
        duration=None if stream.integers(2) else number(stream),
    )


def random_scenario(stream):
    """A scenario drawn from a stream; draws that contradict themselves are drawn again."""
    while True:
        try:
            return _drawn(stream)
        except ShakeError:
            continue


def _drawn(stream):
    scenario = make_scenario(str(stream.choice([*NAMED])))
    changes = {
        path: value * number(stream)
        for path, value in flattened(scenario)
        if isinstance(value, float) and path not in KEPT and stream.random() < 0.3
    }
    for path, value in flattened(scenario.limits, "limits"):
        if value is None and stream.random() < 0.3:
            changes[path] = 10.0 * number(stream)
    storeys = int(stream.integers(1, 7))
    for name, size in (("masses", 40.0), ("stiffnesses", 9e4), ("dampings", 200.0)):
        sizes = [size * number(stream) for _ in range(storeys)]
        equal = scenario.uncertainty.active  # of which only equal storeys are drawn
        changes[f"specimen.{name}"] = sizes[:1] * storeys if equal else sizes
    if stream.random() < 0.4:
        changes["uncertainty.leakage"] = Uniform(1e-16, 1e-12 * number(stream))
        changes["uncertainty.delay"] = [0.0, 4.0 * number(stream)]
    if stream.random() < 0.5:
        signals = stream.permutation([*UNITS])[: stream.integers(1, len(UNITS) + 1)]
        changes["sensing.sensors"] = tuple(
            Sensor(signal=str(s), noise=1e-3 * number(stream), bias=0.0 if stream.integers(2) else 1e-3,
                   lowpass_frequency=None if stream.integers(2) else 90.0 * number(stream))
            for s in signals
        )  # fmt: skip
        changes["sensing.preview"] = 0.05 * int(stream.integers(4))
        changes["sensing.history"] = int(stream.integers(3))
        changes["sensing.last_action"] = bool(stream.integers(2))
    motion = random_motion(stream)
    if motion is not None:
        changes = {path: value for path, value in changes.items() if not path.startswith("motion")}
        changes["motion"] = motion
    changes["name"] = str(stream.choice(["mine", 'a "name"\\', "Tisch größer 1 µm", "#1\t2"]))
    if stream.random() < 0.3:
        changes["physics_step"], changes["control_rate"] = 5e-4, 250.0
    return with_fields(scenario, changes)


def first_steps(scenario, steps=4):
    """Observations and rewards of the first steps of an episode under random actions."""
    simulation = Simulation(scenario, 2)
    streams = [np.random.default_rng(seed) for seed in (1, 2)]
    values = [simulation.start(range(2), streams, None)]
    actions = np.random.default_rng(3).uniform(-0.2, 0.2, (steps, 2))
    for action in actions:
        result = simulation.step(action)
        values += [result.observation, result.reward]
    return values
