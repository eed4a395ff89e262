import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.signal import lsim

import agents.studies.validation.run
from agents.studies.validation.ranges import RANGES, check_motion, check_peaks
from agents.studies.validation.reduction import reduce_loop
from agents.studies.validation.responses import (
    SAMPLED,
    Group,
    continuous_loops,
    continuous_response,
    motion_groups,
    sampled_gains,
    sampled_responses,
    smooth_target,
)
from agents.studies.validation.run import SHOWN, validate
from agents.studies.validation.tables import peaks_table
from baselines.analysis.balanced_truncation import balanced_truncation
from baselines.analysis.closed_loop import closed_loop, forced_response
from baselines.lqr.continuous import continuous_lqr
from shake_env.model.parameters import Actuator, GroundFilter, ModelEquations, Specimen
from shake_env.model.plant import CoupledPlant
from shake_env.model.random_numbers import episode_key
from shake_env.motion.targets import FilteredNoise, RecordedMotion
from shake_env.rollout import Earthquake
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario import Scenario
from shake_env.simulation.excitation import Excitation

DOC = Path(__file__).parents[3] / "docs" / "validation.md"
STEP = 1e-3


def plant_with(highpass=None):
    ground = GroundFilter(highpass_frequency=highpass)
    return CoupledPlant(Actuator(), Specimen.uniform(mass_ratio=0.5), ground, ModelEquations())


def wave(samples):
    t = STEP * np.arange(samples)
    return np.sin(2.0 * np.pi * 3.0 * t) ** 2 * np.sin(2.0 * np.pi * 1.3 * t) * np.exp(-t)


# --- the stiff response against other implementations


@pytest.mark.parametrize("highpass", [None, 0.5])
def test_response_equals_an_ode_solver_on_the_driven_plant(highpass):
    # The other way round: no w, no inverse filter, no steady coordinates, no matrix exponential. The
    # plant without its filter is driven by y~, and the law reads the filter state that y~'s integrals
    # make up.
    plant = plant_with(highpass)
    gain = continuous_lqr(plant, q_1=1e3, q_2=1e-3).gain  # poles up to 2.8e5 rad/s
    target = wave(250)
    loop = closed_loop(plant, gain)
    found = forced_response(loop.system, plant.ground, target, STEP, loop.index["table_velocity"])

    spline = CubicSpline(STEP * np.arange(len(target)), target, bc_type="natural")
    v, x, X = (spline.antiderivative(k) for k in (1, 2, 3))
    g = plant.ground
    size = 2.0 * g.damping_ratio * g.omega
    w_h = 2.0 * np.pi * (highpass or 0.0)
    f = 2.0 * g.highpass_damping_ratio * w_h
    driven, first = plant.driven, plant.layout.filter_states
    scale = plant.state_scale[first:]

    def current(t, state):
        filtered = [
            v(t) + f * x(t) + w_h**2 * X(t), spline(t) + f * v(t) + w_h**2 * x(t),
        ]  # fmt: skip
        ground = np.array(filtered) / size
        if highpass:
            ground = np.append(ground, [x(t), v(t)])
        return -gain[:first] @ ground - gain[first:] @ state

    def rate(t, scaled):
        state = scaled * scale
        return (driven.A @ state + driven.B @ [current(t, state), spline(t)]) / scale

    end = STEP * (len(target) - 1)
    A = (driven.A - np.outer(driven.B[:, 0], gain[first:])) * scale / scale[:, None]
    solved = solve_ivp(
        rate, (0.0, end), np.zeros(len(scale)), "Radau", jac=A, t_eval=[0.1, 0.2, end],
        rtol=1e-7, atol=1e-10, max_step=5e-3,
    )  # fmt: skip
    assert solved.success
    for t, scaled in zip(solved.t, solved.y.T, strict=True):
        state = scaled * scale
        sample = found.outputs[round(t / STEP)]
        for name, value in zip(("load_pressure", "table_velocity", "spool_position"),
                               state[[0, 2, 3]], strict=True):  # fmt: skip
            i = loop.index[name]
            assert sample[i] == pytest.approx(value, abs=2e-5 * np.max(np.abs(found.outputs[:, i])))
    x_a = solved.y[1, -1] * scale[1]
    assert found.displacement[-1] == pytest.approx(x_a, abs=1e-5 * np.max(np.abs(found.displacement)))
    np.testing.assert_allclose(found.outputs[:, loop.index["target_acceleration"]], target, atol=1e-9)


def test_response_of_a_reduced_model_equals_scipy_lsim():
    plant = plant_with()
    loop = closed_loop(plant, continuous_lqr(plant, q_1=1e3, q_2=1e-3).gain)
    full = loop.scaled(loop.outputs[:-1])
    small = balanced_truncation(full, 7, "low").system
    target = wave(3000)
    found = forced_response(small, plant.ground, target, STEP, loop.index["table_velocity"])
    # lsim runs its input straight between samples, the response along a spline: equal to step squared.
    _, expected, _ = lsim((small.A, small.B, small.C, small.D), found.noise, STEP * np.arange(3000))
    size = np.max(np.abs(expected), axis=0)
    np.testing.assert_allclose(found.outputs / size, expected / size, atol=2e-4)


def test_a_target_that_does_not_begin_at_zero_is_led_up_to():
    plant = plant_with()
    loop = closed_loop(plant, continuous_lqr(plant, q_1=1e3, q_2=1e-3).gain)
    target = 0.01 + wave(500)
    found = forced_response(loop.system, plant.ground, target, STEP, loop.index["table_velocity"])
    error = found.outputs[:, loop.index["acceleration_error"]]
    assert np.max(np.abs(error)) < 0.01 * np.max(target)


# --- what the responses are made of


@pytest.fixture(scope="module")
def noise_group():
    scenario = replace(Scenario(), current_limit=100.0)
    return Group("noise", scenario, [Earthquake("noise", FilteredNoise(duration=4.0), 5)])


def test_physics_states_meet_the_roll_out(noise_group):
    scenario = noise_group.scenario
    motion = sampled_responses(noise_group, sampled_gains(scenario)[SAMPLED])[0]
    signals = motion.signals
    assert all(len(values) == len(motion.time) for values in signals.values())
    velocity = np.diff(signals["table_displacement"]) / STEP
    middle = 0.5 * (signals["table_velocity"][1:] + signals["table_velocity"][:-1])
    # The trapezoidal rule is off by the velocity's second difference over 12; in between samples the
    # second derivative may be larger, here by less than a factor of 2.
    bend = np.max(np.abs(np.diff(signals["table_velocity"], 2)))
    assert np.max(np.abs(velocity - middle)) < 2.0 * bend / 12.0
    # y_A is the slope of the velocity, and the roll-out reports it by itself.
    slope = (signals["table_velocity"][2:] - signals["table_velocity"][:-2]) / (2.0 * STEP)
    assert np.max(np.abs(slope - signals["table_acceleration"][1:-1])) < 0.05 * np.max(np.abs(slope))
    k = scenario.specimen.stiffnesses[0]
    assert np.max(signals["reference_drift"]) == pytest.approx(
        np.max(np.abs(signals["reference_base_shear"])) / k, rel=0.1
    )


def test_the_smooth_target_is_the_motion_and_keeps_its_velocity(noise_group):
    scenario = noise_group.scenario
    motion = sampled_responses(noise_group, sampled_gains(scenario)[SAMPLED])[0]
    given = motion.signals["target_acceleration"]
    smooth = smooth_target(scenario, noise_group.earthquakes[0], len(given))
    assert np.sqrt(np.mean((smooth[1:] - given) ** 2)) < 0.25 * np.sqrt(np.mean(given**2))
    # Its reference specimen, which filters the roughness out, moves alike.
    loop = continuous_loops(scenario)["II"]
    other, _ = continuous_response(loop, scenario, "noise", smooth)
    shear = other.signals["reference_base_shear"][1:]
    np.testing.assert_allclose(
        shear, motion.signals["reference_base_shear"], atol=1e-3 * np.max(np.abs(shear))
    )


def test_high_passed_noise_keeps_its_displacement():
    ground = GroundFilter(highpass_frequency=0.5)
    scenario = replace(Scenario(), ground=ground, current_limit=100.0)
    quake = Earthquake("noise", FilteredNoise(duration=20.0), 3)
    smooth = smooth_target(scenario, quake, 20_000)
    displacement = CubicSpline(STEP * np.arange(len(smooth)), smooth).antiderivative(2)
    excitation = Excitation(scenario.discrete, 1)
    excitation.start([0], [quake.motion], [episode_key(np.random.default_rng(quake.seed))])
    ground = np.array([excitation.advance().ground[0, 2] for _ in range(4000)])
    t = scenario.control_period * np.arange(1, 4001)
    np.testing.assert_allclose(displacement(t), ground, atol=1e-2 * np.max(np.abs(ground)))


def test_groups_and_controllers():
    found = motion_groups(Scenario(), 2)
    assert [g.name for g in found] == ["records", "filtered noise", "high-passed noise"]
    assert found[2].scenario.ground.highpass_frequency == 0.5
    assert len(motion_groups(make_scenario("linear", {"highpass_frequency": 1.0}), 2)) == 2
    assert len(motion_groups(Scenario(), 0)) == 1
    known, unaware = sampled_gains(Scenario()).values()
    assert known.shape == unaware.shape and not np.allclose(known, unaware)


# --- ranges


def test_check_ranges_flags_a_known_violation():
    peaks = {known.quantity: 0.5 * known.rated for known in RANGES}
    assert {c.verdict for c in check_peaks(peaks)} == {"within"}
    peaks |= {"table_displacement": 0.073, "current": 0.050, "load_pressure": float("nan")}
    found = {c.quantity: c for c in check_peaks(peaks)}
    assert found["table_displacement"].verdict == "above rated"
    assert found["current"].verdict == "above limit"
    assert found["current"].peak == pytest.approx(50.0)
    assert found["current"].factor_to_rated == pytest.approx(0.5)
    assert found["current"].factor_to_limit == pytest.approx(0.8)
    assert found["load_pressure"].verdict == "above limit"  # not a number is not within range
    assert found["spool_position"].verdict == "within"


def signals(**peaks):
    names = [known.quantity for known in RANGES] + [
        "target_acceleration", "base_shear", "reference_base_shear", "reference_drift",
    ]  # fmt: skip
    return {name: np.array([0.0, peaks.get(name, 0.0)]) for name in names}


def test_amplitude_factor_is_the_tightest_of_the_table():
    found = check_motion(
        "c", "g", "m", signals(table_displacement=-0.14, table_velocity=0.3, storey_drift=0.02,
                               reference_drift=0.01, target_acceleration=2.0, table_acceleration=1.0),
    )  # fmt: skip
    assert (found.factor_to_rated, found.decided_by) == (pytest.approx(0.5), "table_displacement")
    assert found.factor_to_limit == pytest.approx(0.076 / 0.14)
    assert found.factor_to_rated_but_stroke == pytest.approx(2.0)
    assert found.decided_by_but_stroke == "table_velocity"
    assert found.factor_for_specimen == pytest.approx(0.25)
    assert (found.acceleration_error, found.base_shear_error) == (pytest.approx(0.5), None)
    assert found.drift_ratio == pytest.approx(2.0)


def test_a_motion_scaled_by_its_factor_is_within_range(noise_group):
    scenario = noise_group.scenario
    gain = sampled_gains(scenario)[SAMPLED]
    first = sampled_responses(noise_group, gain)[0]
    factor = check_motion("LQR", "noise", "noise", first.signals).factor_to_rated
    scaled = [Earthquake("noise", FilteredNoise(duration=4.0, amplitude=0.999 * factor), 5)]
    again = sampled_responses(Group("noise", scenario, scaled), gain)[0]
    checks = check_motion("LQR", "noise", "noise", again.signals).checks
    assert {c.verdict for c in checks if c.quantity != "storey_drift"} == {"within"}


# --- the command


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    free = replace(Scenario(), current_limit=100.0)
    short = [
        Group("records", free, [Earthquake(SHOWN, RecordedMotion(record=SHOWN, duration=4.0))]),
        Group(
            "high-passed noise",
            replace(free, ground=GroundFilter(highpass_frequency=0.5)),
            [Earthquake("noise", FilteredNoise(duration=1.0))],
        ),
    ]
    folder, lines = tmp_path_factory.mktemp("validation"), []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(agents.studies.validation.run, "motion_groups", lambda scenario, noise: short)
        results = validate(Scenario(), folder, lines.append)
    return folder, results, lines


def test_run_writes_tables_and_figures(run):
    folder, results, lines = run
    written = json.loads((folder / "validation.json").read_text())
    expected = {k: v for k, v in results.items() if k not in ("seconds", "files")}
    assert written == json.loads(json.dumps(expected))
    names = {Path(path).name for path in results["files"]}
    assert {"validation.json", "ranges.csv", "reduction.csv", "validation.md"} < names
    assert sum(name.endswith(".png") for name in names) == 4
    assert all(Path(path).stat().st_size > 0 for path in results["files"])
    with (folder / "ranges.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 2 * 4 * len(RANGES)
    assert len(lines) == 4
    assert "| II | **7** |" in (folder / "validation.md").read_text()


def test_run_keeps_every_error_within_its_bound(run):
    _, results, _ = run
    for reduction in results["reduction"].values():
        for row in reduction["orders"]:
            assert max(row["error_cut"], row["error_settled"]) <= row["bound"] + 1e-9
    assert len(results["reduced_responses"]) == 2
    for found in results["reduced_responses"]:
        assert found["energy_gain"] <= found["bound"]
        assert found["peak_difference"]["table_acceleration"] < 1e-3


# --- the page


def doc_rows():
    lines = [line for line in DOC.read_text().splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]


def test_page_has_the_reduction_that_is_computed():
    text = DOC.read_text()
    rows = {(r[0], r[1]): r for r in doc_rows()}
    for table, loop in continuous_loops(Scenario()).items():
        summary = reduce_loop(table, loop).summary
        fast, slow = summary["fastest_pole"], -summary["slowest_pole"]
        assert rows[table, str(summary["full_order"])][2:] == [
            f"{slow:.1e}", f"{fast:.2e}", str(summary["order"]),
            f"{summary['reduced_fastest_pole']:.0f}",
            f"{summary['error_bound'] / summary['h_infinity_norm']:.1e}",
            f"{1e6 * summary['largest_stable_step']:.0f} us",
            f"{1e3 * summary['reduced_largest_stable_step']:.0f} ms",
        ]  # fmt: skip
        for row in summary["orders"]:
            if row["order"] in (3, 5, 7, 9):
                assert rows[table, f"{row['order']} states"][2:] == [
                    f"{row[key]:.1e}" for key in ("bound", "error_cut", "error_settled")
                ]
    assert "shake validate-transients" in text


def test_page_has_the_peaks_of_one_record_under_the_continuous_controller():
    scenario, name = Scenario(), "napa2014_68150_hne"
    target = smooth_target(scenario, Earthquake(name, RecordedMotion(record=name)), 34_990)
    motion, _ = continuous_response(continuous_loops(scenario)["II"], scenario, name, target)
    found = check_motion("continuous II", "records", name, motion.signals)
    _, rows = peaks_table([json.loads(json.dumps(found, default=vars))])
    assert rows[0] in doc_rows()
