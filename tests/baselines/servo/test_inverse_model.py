"""Inverse-model feed-forward: it leaves what its own design says, and more preview leaves less."""

from dataclasses import replace

import numpy as np
import pytest

from baselines.servo.inverse_model import InverseDesign, InverseFeedForward, inverse_law
from baselines.servo.tvc import TVCDesign
from shake_env.errors import ParameterError, ScenarioError
from shake_env.model.nonlinearity import Nonlinearity
from shake_env.model.plant import ground_filter
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.limits import Limits
from shake_env.scenario.presets import laboratory


def spectrum(scenario, frequency):
    response = ground_filter(scenario.plant.ground).frequency_response(2.0 * np.pi * frequency)
    return np.abs(response[:, 0, 0]) ** 2


def predicted_error(scenario, law):
    """Rms of y_A - y~ over rms of y~ by the design's response: at the samples, folding included.

    What the target has above the Nyquist frequency is an error in itself, beside what it folds into.
    """
    weight = spectrum(scenario, law.frequency) * law.spacing
    first = law.frequency <= 0.5 * scenario.control_rate
    missed = np.sum(np.abs(law.tracking - first) ** 2 * weight)
    return np.sqrt((missed + np.sum(weight[~first])) / np.sum(weight))


@pytest.mark.parametrize("feedback", [None, TVCDesign()])
def test_simulated_error_is_the_designs_own(feedback):
    scenario = replace(
        laboratory(),
        nonlinearity=Nonlinearity(),
        limits=Limits(),
        motion=FilteredNoise(duration=20.0, amplitude=0.2),
    )
    if feedback is not None:  # without sensor noise, which the prediction knows nothing of
        quiet = tuple(replace(s, noise=0.0, bias=0.0) for s in scenario.sensing.sensors)
        scenario = replace(scenario, sensing=replace(scenario.sensing, sensors=quiet))
    controller = InverseFeedForward(scenario, InverseDesign(feedback=feedback))
    metrics, _ = rollout(controller, scenario, noise_earthquakes(scenario, 8))
    simulated = np.mean([m.acceleration_rms_error for m in metrics])
    # Start from rest, eight records, and what happens between samples: a tenth.
    assert simulated == pytest.approx(predicted_error(scenario, controller.law), rel=0.1)
    assert simulated < 0.27


def test_more_preview_leaves_less():
    scenario = laboratory()
    errors = [
        predicted_error(scenario, inverse_law(scenario, InverseDesign(preview=preview, cutoff=100.0)))
        for preview in (0, 1, 2, 4, 8, 20)
    ]
    # The fit minimises the stage cost, force and current with it; of the acceleration alone the last
    # ten thousandth may go the other way.
    assert np.all(np.diff(errors) < 1e-3)
    assert errors[-1] < 0.5 * errors[0]


def test_a_steady_velocity_takes_the_tables_own_current():
    scenario = laboratory()
    law = inverse_law(scenario, InverseDesign())
    a = scenario.actuator
    # The ground filter has little below 0.2 Hz: the fit trades a few per cent there for the rest.
    assert np.sum(law.taps) == pytest.approx(a.piston_area / (a.flow_gain * a.valve_gain), rel=0.1)


def test_mistakes_are_named():
    scenario = laboratory()
    with pytest.raises(ScenarioError, match="shows 20 periods"):
        inverse_law(scenario, InverseDesign(preview=21))
    with pytest.raises(ParameterError, match="past"):
        InverseDesign(past=0)
    wide = replace(scenario, sensing=replace(scenario.sensing, preview_spacing=0.01))
    with pytest.raises(ScenarioError, match="control period"):
        inverse_law(wide, InverseDesign())
