import numpy as np
import pytest

from baselines.analysis.h2 import h2_frequency, h2_lyapunov, tracking_response
from baselines.lqr.continuous import continuous_lqr
from shake_env.errors import NumericalError, ParameterError
from shake_env.model.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.model.plant import CoupledPlant, specimen_plant

TABLE_II, TABLE_III = (1e3, 1e-3), (1e-3, 1e3)


def plant(stories, mass_ratio, model="corrected", **ground):
    return CoupledPlant(
        Actuator(),
        Specimen.uniform(stories=stories, mass_ratio=mass_ratio),
        GroundFilter(**ground),
        ModelEquations.named(model),
    )


def assert_methods_agree(case, gain):
    a, b = h2_lyapunov(case, gain), h2_frequency(case, gain)
    assert a.acceleration == pytest.approx(b.acceleration, rel=1e-6)
    # The force error is a difference of two shears, each with the reference's mean square: 5e-16 of that
    # is below one rounding of the model's own coefficients, and neither method can resolve it.
    floor = 5e-16 * case.reference_shear_variance
    assert a.base_shear == pytest.approx(b.base_shear, rel=1e-6, abs=floor)
    return a


@pytest.mark.parametrize("model", ["corrected", "as_printed"])
@pytest.mark.parametrize("weights", [TABLE_II, TABLE_III])
@pytest.mark.parametrize("stories", [2, 5, 10])
def test_lyapunov_and_frequency_integration_agree(model, weights, stories):
    for mass_ratio in (0.1, 0.2, 0.5):
        case = plant(stories, mass_ratio, model)
        gain = continuous_lqr(case, q_1=weights[0], q_2=weights[1]).gain
        norms = assert_methods_agree(case, gain)
        if (model, weights) != ("as_printed", TABLE_III):  # there the force error is zero on paper
            assert norms.base_shear > 1e-13 * case.reference_shear_variance  # the floor decided nothing


@pytest.mark.parametrize("model", ["corrected", "as_printed"])
@pytest.mark.parametrize("weights", [TABLE_II, TABLE_III])
@pytest.mark.parametrize("added_weight", [1e-12, 1e-8, 1e-4, 1.0, 10.0])
def test_methods_agree_under_an_added_weight(model, weights, added_weight):
    case = plant(2, 0.5, model)
    law = continuous_lqr(case, q_1=weights[0], q_2=weights[1], added_weight=added_weight)
    assert_methods_agree(case, law.gain)


def test_methods_agree_with_a_high_pass():
    case = plant(2, 0.5, highpass_frequency=0.5)
    assert_methods_agree(case, continuous_lqr(case, q_1=1e3, q_2=1e-3).gain)


@pytest.mark.parametrize(
    ("stories", "shears"),
    [(2, (24965, 99860, 624125)), (5, (46109, 184435, 1.15272e6)), (10, (51237, 204948, 1.28092e6))],
)
def test_a_table_without_control_stands_still(stories, shears):
    for mass_ratio, shear in zip((0.1, 0.2, 0.5), shears, strict=True):
        case = plant(stories, mass_ratio)
        norms = assert_methods_agree(case, np.zeros(case.layout.order))
        omega, zeta = case.ground.omega, case.ground.damping_ratio
        assert norms.acceleration == pytest.approx(zeta * omega, rel=1e-10)
        assert norms.acceleration == pytest.approx(9.67611, abs=5e-6)
        assert norms.base_shear == pytest.approx(shear, rel=1e-5)  # the reference has five digits
        assert norms.base_shear == pytest.approx(case.reference_shear_variance, rel=1e-10)


def test_force_error_is_the_specimen_driven_by_the_acceleration_error():
    # f_s - f~_s = G_S (y_A - y~), exactly, in the corrected model and in no other.
    omega = np.logspace(-1, 3, 40)
    for model, exact in (("corrected", True), ("as_printed", False)):
        case = plant(5, 0.5, model)
        gain = continuous_lqr(case, q_1=1e3, q_2=1e-3).gain
        response = tracking_response(case, gain, omega)
        building = specimen_plant(case.specimen).frequency_response(omega)[:, 0, 0]
        miss = np.max(np.abs(response[:, 1] / (building * response[:, 0]) - 1.0))
        assert (miss < 1e-6) if exact else (miss > 1.0)


def test_response_of_a_motionless_table_is_the_ground_filter():
    case = plant(2, 0.5)
    omega = np.array([0.1, 3.0, 50.0])
    s, g = 1j * omega, case.ground
    filter_response = 2 * g.damping_ratio * g.omega * s / (
        s**2 + 2 * g.damping_ratio * g.omega * s + g.omega**2
    )  # fmt: skip
    found = tracking_response(case, np.zeros(case.layout.order), omega)[:, 0]
    np.testing.assert_allclose(found, -filter_response, rtol=1e-10)


def test_an_unstable_loop_and_a_wrong_shape_are_refused():
    case = plant(2, 0.5)
    gain = np.zeros(case.layout.order)
    gain[case.layout.table_displacement + 1] = -10.0  # current in the direction of motion
    with pytest.raises(NumericalError, match="closed-loop pole"):
        h2_lyapunov(case, gain)
    with pytest.raises(ParameterError, match="gain shape"):
        h2_frequency(case, np.zeros(3))
