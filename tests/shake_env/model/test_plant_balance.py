"""Momentum and energy of the continuous plant, and what each printed difference does to them."""

from dataclasses import fields, replace

import numpy as np
import pytest
from plants import TABLE_I, plant, random_specimen

from shake_env import Actuator, ModelEquations
from shake_env.model.discretization import DiscretePlant

UNDAMPED = Actuator(table_damping=0.0, leakage=0.0)


def changed_entries(switch):
    base = ModelEquations()
    other = replace(base, **{switch: not getattr(base, switch)})
    a, b = plant(random_specimen(3)), plant(random_specimen(3), equations=other)
    changed = {}
    for matrix in "ABCD":
        x, y = getattr(a.coupled, matrix), getattr(b.coupled, matrix)
        for i, j in zip(*np.nonzero(x != y), strict=True):
            changed[matrix, int(i), int(j)] = (x[i, j], y[i, j])
    return changed, a


# With three storeys: x_W 0:2, x_A 2:6 (p_l x_a v_a x_v), x_S 6:12, x~_S 12:18.
V_A, F_S, V_R = 4, (6, 9), (9, 10, 11)


def test_switch_reaction_on_table():
    changed, p = changed_entries("reaction_on_table")
    k, c = p.specimen.stiffnesses[0], p.specimen.dampings[0]
    # f_s/m_a in v_a', in y_A, and in what the specimen feels.
    places = {("A", V_A, j) for j in F_S} | {("C", 0, j) for j in F_S}
    places |= {("A", i, j) for i in V_R for j in F_S}
    assert set(changed) == places
    for (matrix, i, j), (corrected, printed) in changed.items():
        twice = 2.0 * (k if j == 6 else c) / 180.0
        sign = 1.0 if matrix == "C" or i == V_A else -1.0
        assert corrected - printed == pytest.approx(sign * twice, rel=1e-9)


def test_switch_shear_in_table_acceleration():
    changed, p = changed_entries("shear_in_table_acceleration")
    k, c = p.specimen.stiffnesses[0], p.specimen.dampings[0]
    places = {("C", 0, j) for j in F_S} | {("A", i, j) for i in V_R for j in F_S}
    assert set(changed) == places
    for (matrix, _, j), (corrected, printed) in changed.items():
        sign = 1.0 if matrix == "C" else -1.0
        once = sign * (k if j == 6 else c) / 180.0
        assert corrected - printed == pytest.approx(once, rel=1e-9)


def test_switch_specimen_feels_target():
    changed, p = changed_entries("specimen_feels_target")
    # y~ = 2 zeta_g omega_g x_w' in each floor's equation.
    assert set(changed) == {("A", i, 1) for i in V_R}
    gain = 2.0 * p.ground.damping_ratio * p.ground.omega
    assert all(pair == (0.0, -gain) for pair in changed.values())


def test_switch_oil_modulus_in_stiffness():
    changed, p = changed_entries("oil_modulus_in_stiffness")
    assert set(changed) == {("A", 2, 2), ("A", 2, 4), ("A", 2, 5)}
    for corrected, printed in changed.values():
        assert printed / corrected == pytest.approx(
            p.actuator.oil_volume / p.actuator.bulk_modulus, rel=1e-12
        )


def test_as_printed_is_three_switches():
    printed = ModelEquations.as_printed()
    differing = {
        f.name for f in fields(printed) if getattr(printed, f.name) != getattr(ModelEquations(), f.name)
    }
    assert differing == {"reaction_on_table", "shear_in_table_acceleration", "specimen_feels_target"}


@pytest.mark.parametrize("stories", [1, 2, 7])
def test_total_momentum_changes_by_external_force_only(stories):
    actuator = replace(TABLE_I, table_stiffness=3e4)
    specimen = random_specimen(stories)
    p = plant(specimen, actuator)
    layout, rng = p.layout, np.random.default_rng(1)
    for _ in range(20):
        x = rng.standard_normal(layout.order) * p.state_scale
        rate = p.coupled.A @ x + p.coupled.B @ rng.standard_normal(2)
        p_l, x_a, v_a, _ = x[layout.actuator]
        acceleration = rate[layout.actuator][2]
        relative = rate[layout.specimen][stories:]
        momentum = 180.0 * acceleration + specimen.masses @ (acceleration + relative)
        external = [
            actuator.piston_area * p_l,
            -actuator.table_damping * v_a,
            -actuator.table_stiffness * x_a,
        ]
        size = np.abs(external).sum() + np.abs(specimen.masses @ relative)
        assert abs(momentum - sum(external)) < 1e-12 * size
        # y_A is the table's acceleration, nothing else.
        assert (p.coupled.C @ x)[0] == pytest.approx(acceleration, rel=1e-12)


@pytest.mark.parametrize(
    "equations",
    [
        ModelEquations(reaction_on_table=False),
        ModelEquations(shear_in_table_acceleration=False),
        ModelEquations(specimen_feels_target=True),
    ],
)
def test_each_printed_difference_breaks_the_momentum_balance(equations):
    p = plant(equations=equations)
    layout, specimen = p.layout, p.specimen
    x = np.random.default_rng(2).standard_normal(layout.order) * p.state_scale
    rate = p.coupled.A @ x
    p_l, _, v_a, _ = x[layout.actuator]
    acceleration = rate[layout.actuator][2]
    momentum = 180.0 * acceleration + specimen.masses @ (
        acceleration + rate[layout.specimen][specimen.stories :]
    )
    external = 0.00237 * p_l - 1000.0 * v_a
    assert abs(momentum - external) > 0.01 * abs(external)


def energy_matrix(specimen, actuator):
    """H with x' H x / 2 the energy of oil, table and specimen for x = [p_l, x_a, v_a, x_v, x_r, x_r'].

    Oil: p_l is the difference of two chambers of V/2 that give +-p_l/2 each, and with k_ac the spring
    k_ac d^2/2 at p_l = k_ac d / A_p holds p_l^2 A_p^2 / (2 k_ac) = p_l^2 V / (8 beta).
    """
    n = specimen.stories
    H = np.zeros((4 + 2 * n, 4 + 2 * n))
    H[0, 0] = actuator.oil_volume / (4.0 * actuator.bulk_modulus)
    H[1, 1] = actuator.table_stiffness
    H[2, 2] = actuator.table_mass + sum(specimen.masses)
    r, v = slice(4, 4 + n), slice(4 + n, 4 + 2 * n)
    H[r, r] = specimen.stiffness_matrix
    H[v, v] = np.diag(specimen.masses)
    H[2, v] = H[v, 2] = specimen.masses
    return H


@pytest.mark.parametrize("stories", [1, 2, 10])
@pytest.mark.parametrize("leakage", [0.0, 1e-16, 1e-11])
@pytest.mark.parametrize("table_stiffness", [0.0, 1e5])
def test_energy_never_rises_with_the_valve_shut(stories, leakage, table_stiffness):
    actuator = replace(TABLE_I, leakage=leakage, table_stiffness=table_stiffness)
    specimen = random_specimen(stories)
    p = plant(specimen, actuator)
    H = energy_matrix(specimen, actuator)
    layout = p.layout
    keep = np.r_[layout.controlled]
    model = DiscretePlant(p, 1e-3, 5).model
    step = model.A[np.ix_(keep, keep)]
    x = np.random.default_rng(stories).standard_normal((len(keep), 8)) * p.state_scale[keep, None]
    x[3] = 0.0
    energy = []
    for _ in range(3000):
        energy.append(0.5 * np.einsum("in,ij,jn->n", x, H, x))
        x = step @ x
    energy = np.array(energy)
    # Rounding of the matrix exponential leaves 1e-16 where zeros belong.
    assert np.max(np.abs(x[3])) < 1e-12 * p.state_scale[keep][3]
    assert np.all(np.diff(energy, axis=0) <= 1e-12 * energy[0])
    # It does fall, but for what an oil column without a leak holds a displaced spring by.
    assert np.all(energy[-1] < (0.9 if table_stiffness == 0.0 else 0.999) * energy[0])


def test_energy_balance_is_the_dissipated_power():
    actuator = replace(TABLE_I, leakage=1e-11, table_stiffness=1e5)
    specimen = random_specimen(4)
    p = plant(specimen, actuator)
    keep = np.r_[p.layout.controlled]
    A, H = p.coupled.A[np.ix_(keep, keep)], energy_matrix(specimen, actuator)
    for x in np.random.default_rng(0).standard_normal((10, len(keep))) * p.state_scale[keep]:
        x[3] = 0.0
        power = x @ H @ A @ x
        v_r = x[8:12]
        loss = 1000.0 * x[2] ** 2 + v_r @ specimen.damping_matrix @ v_r + 1e-11 * x[0] ** 2
        assert power == pytest.approx(-loss, rel=1e-9)


@pytest.mark.parametrize("stories", [1, 2, 10])
def test_energy_is_kept_without_damping(stories):
    specimen = replace(random_specimen(stories), dampings=(0.0,) * stories)
    p = plant(specimen, UNDAMPED)
    keep = np.r_[p.layout.controlled]
    H = energy_matrix(specimen, UNDAMPED)
    step = DiscretePlant(p, 1e-3, 5).model.A[np.ix_(keep, keep)]
    x = np.random.default_rng(0).standard_normal((len(keep), 8)) * p.state_scale[keep, None]
    x[3] = 0.0
    first = 0.5 * np.einsum("in,ij,jn->n", x, H, x)
    for _ in range(3000):
        x = step @ x
    # 3000 products with rounding 1e-16 each, of a matrix of norm about 1 in energy.
    assert 0.5 * np.einsum("in,ij,jn->n", x, H, x) == pytest.approx(first, rel=1e-10)


def test_energy_rises_as_printed():
    # f_s with the wrong sign makes the specimen a source: the balance is not a matter of course.
    p = plant(equations=ModelEquations(reaction_on_table=False))
    keep = np.r_[p.layout.controlled]
    A, H = p.coupled.A[np.ix_(keep, keep)], energy_matrix(p.specimen, p.actuator)
    free = np.r_[0, 2, 4:8]
    power = (H @ A + (H @ A).T)[np.ix_(free, free)]
    scale = p.state_scale[keep][free]
    assert np.linalg.eigvalsh(power * np.outer(scale, scale))[-1] > 0.0
    corrected = plant().coupled.A[np.ix_(keep, keep)]
    power = (H @ corrected + (H @ corrected).T)[np.ix_(free, free)] * np.outer(scale, scale)
    assert np.linalg.eigvalsh(power)[-1] < 1e-12 * np.linalg.norm(power)
