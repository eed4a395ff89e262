"""Three-variable control: poles where they were asked for, a flat response over its band."""

import numpy as np
import pytest

from baselines.servo.output_feedback import LinearLaw, NominalTable, SampledClosedLoop
from baselines.servo.tvc import FEEDBACK, TVCDesign, feedback_gains, tvc, tvc_law
from shake_env.errors import NumericalError, ParameterError
from shake_env.scenario.observation import Sensing, Sensor
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.presets import laboratory


def decibels(response):
    return 20.0 * np.log10(np.abs(response))


def test_the_three_poles_are_placed():
    scenario, design = laboratory(), TVCDesign(position_bandwidth=1.5, oil_damping=0.25)
    table = NominalTable.from_scenario(scenario)
    poles = (
        np.log(SampledClosedLoop(table, tvc_law(scenario, design)).poles.astype(complex)) / table.period
    )
    omega = 2.0 * np.pi * scenario.plant.natural_frequencies[-1]
    pair = omega * (-0.25 + 1j * np.sqrt(1.0 - 0.25**2))
    for wanted in (-2.0 * np.pi * 1.5, pair, np.conj(pair)):
        assert np.min(np.abs(poles - wanted)) < 1e-6 * abs(wanted)


def test_acceleration_response_is_flat_over_the_band():
    scenario = laboratory()
    table = NominalTable.from_scenario(scenario)
    gentle = TVCDesign(oil_damping=0.06, highest=5.0)
    ripple = decibels(SampledClosedLoop(table, tvc_law(scenario, gentle)).response(gentle.band))
    assert ripple.min() > -0.3 and ripple.max() < 1.2
    default = TVCDesign()
    loop = SampledClosedLoop(table, tvc_law(scenario, default))
    ripple = decibels(loop.response(default.band))
    assert ripple.min() > -1.3 and ripple.max() < 2.3
    assert decibels(loop.response(np.geomspace(10.0, 99.0, 400))).max() < 10.0
    # Without its feed-forward the same feedback follows acceleration at no frequency of the band's top.
    law = tvc_law(scenario, default)
    errors_alone = np.where(np.arange(8) < 5, law.D, 0.0)
    errors_alone[[7, 6, 5]] = -law.D[FEEDBACK]
    alone = SampledClosedLoop(table, LinearLaw.static(errors_alone)).response(default.band)
    assert np.mean(np.abs(alone - 1.0)) > 4.0 * np.mean(np.abs(loop.response(default.band) - 1.0))


def test_feed_forward_is_the_flattest_of_its_kind():
    scenario, design = laboratory(), TVCDesign()
    table, law = NominalTable.from_scenario(scenario), tvc_law(scenario, design)

    def ripple(D):
        loop = SampledClosedLoop(table, LinearLaw.static(D))
        return np.sum(np.abs(loop.response(design.band) - 1.0) ** 2)

    best = ripple(law.D)
    for target in (5, 6, 7):
        for factor in (0.99, 1.01):
            other = law.D.copy()
            other[target] *= factor
            assert ripple(other) > best


def test_mistakes_are_named():
    with pytest.raises(ParameterError, match="order"):
        TVCDesign(lowest=5.0, highest=2.0)
    with pytest.raises(NumericalError, match="spectral radius"):
        tvc_law(laboratory(), TVCDesign(position_bandwidth=60.0))
    table = NominalTable.from_scenario(laboratory())
    with pytest.raises(NumericalError, match="independent"):
        feedback_gains(table, np.array([0.9, 0.9, 0.8]) + 0j)
    with pytest.raises(ValueError, match="table_acceleration"):
        tvc(
            make_scenario(
                "laboratory",
                {
                    "sensing": Sensing(
                        sensors=(Sensor(signal="table_displacement"), Sensor(signal="table_velocity"))
                    )
                },
            )
        )


@pytest.mark.parametrize(("stories", "frequency"), [(2, 25.0), (5, 22.0)])
def test_a_storey_stiffer_than_the_oil_column_is_not_taken_for_it(stories, frequency):
    specimen = {"stories": stories, "storey_frequency": frequency, "mass_ratio": 0.5}
    scenario = make_scenario("laboratory", specimen)
    plant = scenario.plant
    assert plant.natural_frequencies[-1] > 1.15 * plant.oil_column_frequency
    # The same table under a soft specimen of that mass: what is on it moves the oil column by a percent.
    soft = make_scenario("laboratory", {"stories": 2, "mass_ratio": 0.5}).plant
    assert plant.oil_column_frequency == pytest.approx(soft.natural_frequencies[-1], rel=0.01)
    assert (
        SampledClosedLoop(NominalTable.from_scenario(scenario), tvc_law(scenario, TVCDesign())).radius
        < 1.0
    )
