"""Logs of short simulated tests, for the tests of the laboratory's loop."""

import io
from functools import cache

import numpy as np

from agents.evaluation.perturbations import observation_rescaling
from agents.laboratory.logs.recorder import LogRecorder
from agents.laboratory.logs.test_log import TestLog
from baselines.batch_controllers import Rescaled
from baselines.registry import make_baseline
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake, rollout
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario import Scenario


def noise(seconds=4.0, amplitude=0.22):
    return FilteredNoise(duration=seconds, amplitude=amplitude)


def made(scenario: Scenario, driven=None, seconds=4.0, amplitude=0.22, seed=3, name="lqg") -> TestLog:
    """The log of a test of `driven` (default: the scenario), as the scenario's laboratory has it."""
    quake = [Earthquake("noise", noise(seconds, amplitude), seed)]
    recorder = LogRecorder(scenario, quake, plant=driven)
    controller = make_baseline(name, scenario)
    if driven is not None:
        controller = Rescaled(controller, observation_rescaling(driven, scenario))
    rollout(controller, scenario if driven is None else driven, quake, log=recorder)
    return recorder.logs()[0]


@cache
def laboratory_log(seconds=4.0, amplitude=0.22) -> TestLog:
    return made(make_scenario("laboratory"), seconds=seconds, amplitude=amplitude)


def tdms_bytes(log: TestLog) -> bytes:
    """A log as LabVIEW might have written it: with the attributes of one of this program's."""
    from nptdms import ChannelObject, RootObject, TdmsWriter

    from agents.laboratory.logs.raw import attributes_of, column_unit

    held = io.BytesIO()
    channels = [
        ChannelObject("channels", name, values, {"unit_string": column_unit(log, name)})
        for name, values in log.channels.items()
    ]
    with TdmsWriter(held) as writer:
        writer.write_segment([RootObject(attributes_of(log)), *channels])
    return held.getvalue()


def hdf5_of_matlab(log: TestLog) -> bytes:
    """A foreign MATLAB 7.3 file with the channels as columns."""
    import h5py

    held = io.BytesIO()
    with h5py.File(held, "w", userblock_size=512) as file:
        for name, values in log.channels.items():
            data = file.create_dataset(name, data=values[None])
            data.attrs["MATLAB_class"] = np.bytes_("double")
    content = bytearray(held.getvalue())
    content[:116] = b"MATLAB 7.3 MAT-file".ljust(116)
    return bytes(content)
