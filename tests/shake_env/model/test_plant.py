"""The continuous plant against theory and against models put together in other ways."""

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from plants import TABLE_I, plant, random_specimen
from scipy.linalg import eigh, expm

from shake_env import GroundFilter, ModelEquations, Specimen
from shake_env.errors import ParameterError
from shake_env.model.plant import StateSpace, actuator_plant, ground_filter, specimen_plant


def mass_stiffness_frequencies(specimen, actuator=TABLE_I):
    """Free vibration of table and storeys in absolute coordinates, element by element [Hz]."""
    n = specimen.stories
    k_ac = 4.0 * actuator.bulk_modulus * actuator.piston_area**2 / actuator.oil_volume
    M = np.diag([actuator.table_mass, *specimen.masses])
    K = np.zeros((n + 1, n + 1))
    K[0, 0] = k_ac + actuator.table_stiffness
    for storey, k in enumerate(specimen.stiffnesses):
        K[storey : storey + 2, storey : storey + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    return np.sqrt(eigh(K, M, eigvals_only=True)) / (2.0 * math.pi)


@pytest.mark.parametrize("stories", range(1, 13))
@pytest.mark.parametrize("kind", ["uniform", "per storey"])
def test_natural_frequencies_against_mass_and_stiffness(stories, kind):
    specimen = Specimen.uniform(stories=stories) if kind == "uniform" else random_specimen(stories)
    found = plant(specimen).natural_frequencies
    assert found.shape == (stories + 1,)
    assert found == pytest.approx(mass_stiffness_frequencies(specimen), rel=1e-6)


def test_natural_frequencies_of_a_table_on_springs():
    actuator = replace(TABLE_I, table_stiffness=5e6)
    specimen = random_specimen(4)
    expected = mass_stiffness_frequencies(specimen, actuator)
    assert plant(specimen, actuator).natural_frequencies == pytest.approx(expected, rel=1e-6)


def test_printed_and_corrected_frequencies_of_the_paper():
    """SPEC 3. Its mass-stiffness value of the first mode, 4.311, is 4.31048: rounded up from 4.3105."""
    undamped = mass_stiffness_frequencies(Specimen.uniform())
    assert undamped == pytest.approx([4.3105, 11.309, 35.247], abs=0.5e-3)

    def moduli(equations):
        # With damping, as the two state spaces stand; position and spool (1/T_v = 15.9 Hz) are real.
        p = plant(equations=equations)
        keep = np.r_[p.layout.controlled]
        scale = p.state_scale[keep]
        eigenvalues = np.linalg.eigvals(p.coupled.A[np.ix_(keep, keep)] * scale / scale[:, None])
        return np.sort(np.abs(eigenvalues[eigenvalues.imag > 1.0])) / (2.0 * math.pi)

    assert moduli(ModelEquations()) == pytest.approx([4.311, 11.310, 35.245], abs=0.5e-3)
    assert moduli(ModelEquations.as_printed()) == pytest.approx([5.242, 11.508, 34.883], abs=0.5e-3)
    assert plant().natural_frequencies == pytest.approx(undamped, rel=1e-6)


def test_fixed_base_first_mode_of_the_paper():
    for stories, printed in ((2, 4.326), (5, 1.992), (10, 1.046)):
        first = Specimen.uniform(stories=stories).fixed_base_frequencies[0]
        assert first == pytest.approx(14.0 * math.sin(math.pi / (2 * (2 * stories + 1))), rel=1e-12)
        assert first == pytest.approx(printed, abs=0.5e-3)


def test_target_variance():
    assert plant().target_variance == pytest.approx(9.67611, abs=0.5e-5)
    assert plant().target_variance == pytest.approx(1.4 * 2.0 * math.pi * 1.1, rel=1e-12)


@pytest.mark.parametrize(
    ("stories", "mass_ratio", "printed", "half_digit"),
    [
        (2, 0.1, 24965, 0.5),
        (2, 0.2, 99860, 0.5),
        (2, 0.5, 624125, 0.5),
        (5, 0.1, 46109, 0.5),
        (5, 0.2, 184435, 0.5),
        (5, 0.5, 1.15272e6, 5.0),
        (10, 0.1, 51237, 0.5),
        (10, 0.2, 204948, 0.5),
        (10, 0.5, 1.28092e6, 5.0),
    ],
)
def test_reference_shear_variance(stories, mass_ratio, printed, half_digit):
    specimen = Specimen.uniform(stories=stories, mass_ratio=mass_ratio)
    found = plant(specimen).reference_shear_variance
    assert found == pytest.approx(printed, abs=half_digit)
    # It goes with the square of the mass.
    tenth = plant(Specimen.uniform(stories=stories, mass_ratio=0.1 * mass_ratio))
    assert found == pytest.approx(100.0 * tenth.reference_shear_variance, rel=1e-9)


@pytest.mark.parametrize("highpass", [None, 0.5])
def test_variances_against_integration_over_frequency(highpass):
    p = plant(random_specimen(3), ground=GroundFilter(highpass_frequency=highpass))
    # omega = tan(theta) turns the whole axis into a finite one; the integrand is smooth in theta.
    theta = np.linspace(0.0, math.pi / 2, 30001)[1:-1]
    omega = 30.0 * np.tan(theta)
    weight = 30.0 / np.cos(theta) ** 2
    response = p.coupled.frequency_response(omega)[:, [2, 3], 1]
    density = np.abs(response) ** 2 * weight[:, None]
    found = np.sum(density, axis=0) * (theta[1] - theta[0]) / math.pi
    # Simple sums miss the ends' half cells: y~ falls as 1/omega, its last cell is 1e-5 of all.
    assert found[1] == pytest.approx(p.reference_shear_variance, rel=1e-6)
    assert found[0] == pytest.approx(p.target_variance, rel=1e-4)


def test_undamped_reference_has_no_variance_but_the_target_has():
    p = plant(Specimen.uniform(damping_ratio=0.0))
    assert p.target_variance == pytest.approx(9.67611, abs=0.5e-5)
    with pytest.raises(ParameterError, match=r"dampings.*no stationary base shear.*damp every"):
        _ = p.reference_shear_variance


def as_control(model, name, inputs, outputs):
    return control.ss(model.A, model.B, model.C, model.D, name=name, inputs=inputs, outputs=outputs)


def scaled(model, scale):
    # python-control does not balance, and loses digits on states that span ten decades.
    return StateSpace(
        model.A * scale / scale[:, None], model.B / scale[:, None], model.C * scale, model.D
    )


@pytest.mark.parametrize("highpass", [None, 0.5])
def test_coupled_plant_against_python_controls_interconnection(highpass):
    specimen, equations = random_specimen(3), ModelEquations()
    p = plant(specimen, ground=GroundFilter(highpass_frequency=highpass))
    table = actuator_plant(TABLE_I, equations)
    joined = control.interconnect(
        [
            as_control(ground_filter(p.ground), "ground", ["w"], ["y"]),
            as_control(scaled(table, p.state_scale[p.layout.actuator]), "table", ["u", "f"], ["a"]),
            as_control(specimen_plant(specimen), "building", ["a"], ["f"]),
            as_control(specimen_plant(specimen), "reference", ["y"], ["f_ref"]),
        ],
        inplist=["u", "w"],
        outlist=["table.a", "building.f", "ground.y", "reference.f_ref"],
        check_unused=False,
    )
    omega = np.logspace(-1, 3.5, 200)
    found = p.coupled.frequency_response(omega)
    other = joined.frequency_response(omega).frdata.transpose(2, 0, 1)
    for output in range(4):
        for source in range(2):
            a, b = found[:, output, source], other[:, output, source]
            if np.all(a == 0):  # no link; other arithmetic leaves rounding there
                assert np.max(np.abs(b)) < 1e-9 * np.max(np.abs(other[:, output]))
            else:
                assert np.max(np.abs(a - b)) < 1e-9 * np.max(np.abs(b))
    # And no quiet link: the current never reaches the target, nor the noise the table.
    assert np.all(found[:, 2:, 0] == 0) and np.all(found[:, :2, 1] == 0)


def test_frequency_response_against_transfer_functions_written_by_hand():
    """One storey: u to y_A and f_s, from Newton's law and the oil's continuity in s."""
    specimen = Specimen(masses=(60.0,), stiffnesses=(1.2e5,), dampings=(150.0,))
    actuator = replace(TABLE_I, leakage=2e-12, table_stiffness=4e4)
    p = plant(specimen, actuator)
    a = actuator
    omega = np.logspace(0, 3, 50)
    s = 1j * omega
    # Relative displacement and shear for a unit table acceleration.
    x_r = -60.0 / (60.0 * s**2 + 150.0 * s + 1.2e5)
    shear = (150.0 * s + 1.2e5) * x_r
    valve = a.valve_gain / (1.0 + a.valve_time_constant * s)
    oil = 4.0 * a.bulk_modulus / a.oil_volume
    # v per x_v: A_p p = (m s + c + k/s - shear s) v and p (s + oil K_c) = oil (K_q x_v - A_p v).
    impedance = a.table_mass * s + a.table_damping + a.table_stiffness / s - shear * s
    v = (
        oil
        * a.flow_gain
        * valve
        / (impedance * (s + oil * a.leakage) / a.piston_area + oil * a.piston_area)
    )
    found = p.coupled.frequency_response(omega)[:, :, 0]
    assert found[:, 0] == pytest.approx(s * v, rel=1e-9)
    assert found[:, 1] == pytest.approx(shear * s * v, rel=1e-9)


def test_target_filter_against_its_transfer_function():
    ground = GroundFilter(frequency=1.7, damping_ratio=0.6, highpass_frequency=0.4)
    omega = np.logspace(-1, 3, 60)
    s, w, w_h = 1j * omega, 2 * math.pi * 1.7, 2 * math.pi * 0.4
    kanai = 2 * 0.6 * w * s / (s**2 + 2 * 0.6 * w * s + w**2)
    clough = s**2 / (s**2 + 2 * 0.7 * w_h * s + w_h**2)
    found = ground_filter(ground).frequency_response(omega)[:, 0, 0]
    assert found == pytest.approx(kanai * clough, rel=1e-10)
    plain = ground_filter(replace(ground, highpass_frequency=None))
    assert plain.frequency_response(omega)[:, 0, 0] == pytest.approx(kanai, rel=1e-10)


def test_identical_base_motion_gives_identical_shear():
    """A motionless table under no target leaves f_s and f~_s alone; the printed model does not."""
    for equations, moved in ((ModelEquations(), False), (ModelEquations.as_printed(), True)):
        p = plant(equations=equations)
        layout = p.layout
        # Rigid table: take its states out, so that y_A = 0.
        keep = np.r_[layout.ground, layout.specimen, layout.reference]
        A = p.coupled.A[np.ix_(keep, keep)].copy()
        n = 2 * layout.stories
        A[2 : 2 + n, 2 : 2 + n] = specimen_plant(p.specimen).A  # without the table's response
        x = expm(A * 0.3) @ np.r_[0.0, 1.0, np.zeros(2 * n)]
        specimen, reference = x[2 : 2 + n], x[2 + n :]
        if moved:
            # SPEC 3: a motionless table gives f_s = f~_s as printed.
            assert specimen == pytest.approx(reference, rel=1e-10)
        else:
            assert np.all(specimen == 0.0) and np.linalg.norm(reference) > 0.0


@pytest.mark.parametrize("highpass", [None, 0.5])
@pytest.mark.parametrize("stories", [1, 5])
def test_layout_names_every_state(highpass, stories):
    p = plant(Specimen.uniform(stories=stories), ground=GroundFilter(highpass_frequency=highpass))
    layout = p.layout
    assert layout.order == p.coupled.order == len(layout.names) == len(p.state_scale)
    assert layout.order == (6 if highpass is None else 8) + 4 * stories
    assert layout.names[layout.table_displacement] == "table displacement [m]"
    pieces = (layout.ground, layout.actuator, layout.specimen, layout.reference)
    assert [i for piece in pieces for i in range(piece.start, piece.stop)] == list(range(layout.order))
    assert (layout.controlled.start, layout.controlled.stop) == (
        layout.actuator.start,
        layout.specimen.stop,
    )


def test_state_scale_is_the_rms_under_perfect_tracking():
    """Against a simulation of a table that moves exactly like the target: shaper, not controller."""
    p = plant(random_specimen(2))
    # x_W and x~_S are driven by noise alone: scale = stationary rms by integration over frequency.
    exogenous = np.r_[p.layout.ground, p.layout.reference]
    A = p.coupled.A[np.ix_(exogenous, exogenous)]
    B = p.coupled.B[exogenous, 1:]
    model = StateSpace(A, B, np.eye(len(A)), np.zeros((len(A), 1)))
    theta = np.linspace(0.0, math.pi / 2, 40001)[1:-1]
    response = np.abs(model.frequency_response(30.0 * np.tan(theta))[:, :, 0]) ** 2
    variance = (
        np.sum(response * (30.0 / np.cos(theta) ** 2)[:, None], axis=0) * (theta[1] - theta[0]) / math.pi
    )
    assert p.state_scale[exogenous] == pytest.approx(np.sqrt(variance), rel=1e-4)
    # The specimen on the table is measured by the reference's normaliser.
    assert np.array_equal(p.state_scale[p.layout.specimen], p.state_scale[p.layout.reference])
    # v_a: integral of y~, rms sqrt(zeta_g / omega_g).
    assert p.state_scale[p.layout.actuator][2] == pytest.approx(
        math.sqrt(1.4 / (2 * math.pi * 1.1)), rel=1e-12
    )


def test_state_scale_of_the_table():
    """What the actuator has to give for y~: its flow, and the force on mass, damper and specimen."""
    p = plant()
    omega, zeta = p.ground.omega, p.ground.damping_ratio
    v, y = math.sqrt(zeta / omega), math.sqrt(p.target_variance)
    force = math.sqrt((180.0 * y) ** 2 + (1000.0 * v) ** 2 + p.reference_shear_variance)
    expected = [force / 0.00237, v / omega, v, 0.00237 * v / 76.0]
    assert p.state_scale[p.layout.actuator] == pytest.approx(expected, rel=1e-9)


def test_state_scale_keeps_its_meaning():
    base = plant()
    for other in (
        plant(equations=ModelEquations.as_printed()),
        plant(specimen=Specimen.uniform(damping_ratio=0.05)),
    ):
        assert np.array_equal(base.state_scale, other.state_scale)
    highpass = plant(ground=GroundFilter(highpass_frequency=0.5)).state_scale
    assert np.array_equal(np.delete(highpass, [2, 3]), base.state_scale)
    assert np.all(np.isfinite(plant(Specimen.uniform(damping_ratio=0.0)).state_scale))


def test_state_space_refuses_shapes_that_do_not_fit():
    with pytest.raises(ParameterError, match="shapes"):
        StateSpace(np.eye(2), np.zeros((3, 1)), np.zeros((1, 2)), np.zeros((1, 1)))
