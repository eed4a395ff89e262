import control
import numpy as np
import pytest
from scipy.linalg import solve_continuous_are

from baselines.analysis.h2 import h2_lyapunov
from baselines.lqr import continuous as lqr_continuous
from baselines.lqr.continuous import (
    MOST_WEIGHT,
    SteadyCoordinates,
    continuous_lqr,
    performance_rows,
    printed_added_weight,
)
from baselines.lqr.design_states import observable_states
from shake_env.errors import ParameterError
from shake_env.model.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.model.plant import CoupledPlant

TABLE_II = {"q_1": 1e3, "q_2": 1e-3}
TABLE_III = {"q_1": 1e-3, "q_2": 1e3}


def plant(stories, mass_ratio, model="corrected", **actuator):
    return CoupledPlant(
        Actuator(**actuator),
        Specimen.uniform(stories=stories, mass_ratio=mass_ratio),
        GroundFilter(),
        ModelEquations.named(model),
    )


# Reference values have two or three digits: half of the last one is the tolerance.
@pytest.mark.parametrize(
    ("mass_ratio", "shear", "half_digit"),
    [(0.1, 6.2e-4, 0.05e-4), (0.2, 2.5e-3, 0.05e-3), (0.5, 1.55e-2, 0.005e-2)],
)
def test_corrected_model_tracks_both_with_the_weights_of_table_ii(mass_ratio, shear, half_digit):
    case = plant(2, mass_ratio)
    norms = h2_lyapunov(case, continuous_lqr(case, **TABLE_II).gain)
    assert norms.acceleration == pytest.approx(0.00142, abs=0.000005)
    assert norms.base_shear == pytest.approx(shear, abs=half_digit)


@pytest.mark.parametrize(
    ("stories", "mass_ratio", "shear", "half_digit"),
    [
        (2, 0.1, 2.5e4, 0.05e4), (2, 0.2, 1.0e5, 0.05e5), (2, 0.5, 6.2e5, 0.05e5),
        (5, 0.1, 4.6e4, 0.05e4), (5, 0.2, 1.8e5, 0.05e5), (5, 0.5, 1.15e6, 0.005e6),
    ],
)  # fmt: skip
def test_printed_model_with_the_weights_of_table_ii(stories, mass_ratio, shear, half_digit):
    case = plant(stories, mass_ratio, "as_printed")
    norms = h2_lyapunov(case, continuous_lqr(case, **TABLE_II).gain)
    assert norms.acceleration == pytest.approx(0.00142, abs=0.000005)
    assert norms.base_shear == pytest.approx(shear, abs=half_digit)


@pytest.mark.parametrize("stories", [2, 5, 10])
@pytest.mark.parametrize("mass_ratio", [0.1, 0.2, 0.5])
def test_printed_model_stands_still_with_the_weights_of_table_iii(stories, mass_ratio):
    case = plant(stories, mass_ratio, "as_printed")
    norms = h2_lyapunov(case, continuous_lqr(case, **TABLE_III).gain)
    assert norms.acceleration == pytest.approx(9.67611, abs=5e-5)
    # Zero up to q_1, which still asks for a little motion, and rounding of f_s - f~_s (see h2_lyapunov).
    assert abs(norms.base_shear) < 1e-15 * case.reference_shear_variance


@pytest.mark.parametrize("stories", [2, 10])
def test_slow_pole_is_the_one_of_theory(stories):
    # At a steady velocity an error costs q_1 v' or q_2 M v', the holding current r A_p/(K_q K_v) v; the
    # optimal decay is their ratio. The rest of the dynamics is 1e5 times faster, hence 1e-5.
    case = plant(stories, 0.5)
    a = case.actuator
    holding = a.piston_area / (a.flow_gain * a.valve_gain)
    assert continuous_lqr(case, **TABLE_II).slowest_pole == pytest.approx(-holding / 1e3, rel=1e-5)
    expected = -holding / (1e3 * case.specimen.mass)
    # 4e-14 of the fastest pole: double precision leaves four of its digits.
    assert continuous_lqr(case, **TABLE_III).slowest_pole == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("weight", [1e-9, 1e-4, 1.0])
@pytest.mark.parametrize("model", ["corrected", "as_printed"])
def test_gain_on_the_position_is_the_one_of_theory(weight, model):
    # An integrator that nothing else sees, weighted by lambda: its row of the Riccati equation reads
    # lambda = (r k)^2. Ten digits go to the other entries of the same solution.
    case = plant(5, 0.2, model)
    gain = continuous_lqr(case, **TABLE_II, r=2.0, added_weight=weight).gain
    position = case.layout.table_displacement
    assert abs(gain[position]) == pytest.approx(np.sqrt(weight) / 2.0, rel=1e-5)
    assert continuous_lqr(case, **TABLE_II).gain[position] == 0.0


@pytest.mark.parametrize("model", ["corrected", "as_printed"])
def test_agrees_with_python_control_where_the_problem_is_well_posed(model):
    # A spring on the table ends the steady motion, leakage a standing pressure, and mild weights keep
    # every pole below 1e3 rad/s.
    case = plant(2, 0.5, model, table_stiffness=2e5, leakage=1e-11)
    kept, scale = observable_states(case), case.state_scale
    assert len(kept) == case.layout.order
    q_1, q_2, r = 0.01, 1e-5, 1.0
    W = performance_rows(case, q_1, q_2) * scale
    A = case.coupled.A * scale / scale[:, None]
    B = case.coupled.B[:, :1] / scale[:, None]
    K, _, _ = control.lqr(A, B, W.T @ W, np.array([[r**2]]), method="scipy")
    ours = continuous_lqr(case, q_1=q_1, q_2=q_2, r=r).gain * scale
    assert np.max(np.abs(ours)) > 1e-4  # not the comparison of two zeros
    np.testing.assert_allclose(ours, K[0], rtol=1e-7, atol=1e-9 * np.max(np.abs(K)))


def test_newton_recovers_from_a_riccati_solution_that_is_far_off(monkeypatch):
    # With a spring and without leakage, SciPy's gain for the printed model is 1e4 times too large.
    case = plant(2, 0.5)
    good = continuous_lqr(case, **TABLE_II)

    def far_off(A, b, Q, R, s):
        return 50.0 * solve_continuous_are(A, b, Q, R, s=s)

    monkeypatch.setattr(lqr_continuous, "solve_continuous_are", far_off)
    found = continuous_lqr(case, **TABLE_II)
    scale = case.state_scale
    np.testing.assert_allclose(
        found.gain * scale, good.gain * scale, atol=1e-9 * np.max(np.abs(good.gain * scale))
    )


def test_steady_coordinates_are_the_same_plant():
    case = plant(5, 0.2, "as_printed")
    xi = SteadyCoordinates.from_plant(case)
    rng = np.random.default_rng(4)
    state, current, noise = rng.normal(size=case.layout.order), 0.3, -1.2
    x = xi.transform @ state
    u = xi.holding @ state + current
    rate = case.coupled.A @ x + case.coupled.B @ [u, noise]
    C = case.coupled.C
    expected = np.linalg.solve(xi.transform, rate)
    found = xi.A @ state + xi.B @ [current, noise]
    # Rows in units of each state's rms per second; terms of 1e5 cancel in the pressure's row.
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.max(np.abs(expected)))
    np.testing.assert_allclose(xi.E @ state, [(C[0] - C[2]) @ x, (C[1] - C[3]) @ x], rtol=1e-9)
    gain = rng.normal(size=case.layout.order) / case.state_scale
    np.testing.assert_allclose(xi.physical_gain(xi.shifted_gain(gain)), gain, rtol=1e-9)


def test_printed_regularisation_is_rounding_noise_and_the_gain_follows_it():
    case = plant(2, 0.5, "as_printed")
    E_1 = performance_rows(case, 1e-3, 1e3)
    R_1 = E_1.T @ E_1
    assert np.linalg.matrix_rank(E_1 * case.state_scale) == 2  # so the smallest eigenvalue is zero
    noise = len(R_1) * np.finfo(float).eps * np.linalg.norm(R_1, 2)
    weights = [
        printed_added_weight(case, q_1=1e-3, q_2=1e3),
        5.0 * abs(np.linalg.eigvalsh(R_1[::-1, ::-1])[0]),  # the same matrix, states in reverse order
        5.0 * abs(np.min(np.linalg.eigvals(R_1).real)),
        5.0 * np.linalg.svd(R_1, compute_uv=False)[-1],
    ]
    assert max(weights) < 5.0 * noise
    assert max(weights) > 2.0 * min(weights)  # four right ways to compute one number
    laws = [
        continuous_lqr(case, **TABLE_III, added_weight=min(w, MOST_WEIGHT))
        for w in (min(weights), max(weights))
    ]
    scaled = [law.gain * case.state_scale for law in laws]
    assert np.max(np.abs(scaled[0] - scaled[1])) > 0.1 * np.max(np.abs(scaled[0]))


def test_weights_are_checked():
    case = plant(2, 0.5)
    with pytest.raises(ParameterError, match="q_1"):
        continuous_lqr(case, q_1=-1.0, q_2=1.0)
    with pytest.raises(ParameterError, match="at least one error"):
        continuous_lqr(case, q_1=0.0, q_2=0.0)
    with pytest.raises(ParameterError, match=r"^r ="):
        continuous_lqr(case, **TABLE_II, r=0.0)
    with pytest.raises(ParameterError, match="added_weight"):
        continuous_lqr(case, **TABLE_II, added_weight=10.0 * MOST_WEIGHT)
