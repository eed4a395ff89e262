"""Exported C programs decide as Python does, compile cleanly, and refuse what is not finite."""

import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from memory_units import KINDS, random_unit

from agents.deployment.accuracy import (
    EXACT,
    EXCEPTIONS,
    SANITIZED,
    SINGLE,
    STEP,
    action_differences,
    agreement,
    random_observations,
    run_test_program,
)  # fmt: skip
from agents.deployment.c_source import c_number, render_program, write_program
from agents.deployment.compiled import CompiledController, CompiledProgram, build_test
from agents.deployment.controller_program import as_program, controller_program
from agents.deployment.exported import NOT_EXPORTED, exported
from agents.deployment.laws import block_of
from agents.deployment.plant import plant_program
from agents.deployment.recorded import record_decisions
from agents.deployment.widened import to_float64
from agents.policies.policy_file import PolicyFile
from agents.policies.registry import controllers, get_controller, policies_trained_for
from baselines.estimation.adaptive import CertaintyEquivalence
from baselines.estimation.specimen_bank import SpecimenBank
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.controller import decide
from shake_env.dynamics.nonlinear import floor_rows
from shake_env.errors import ScenarioError, ShakeError
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.presets import NAMED
from shake_env.scenario.uncertainty import Uncertainty, Uniform
from shake_env.simulation.transition import TableModel

COMPILERS = [
    pytest.param(cc, marks=pytest.mark.skipif(shutil.which(cc) is None, reason=f"{cc} is not installed"))
    for cc in ("gcc", "clang")
]
needs_compiler = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)
pytestmark = needs_compiler


def assert_exact(difference):
    assert np.mean(difference > EXACT) <= EXCEPTIONS
    assert difference.max() <= STEP


CASES = [
    ("linear", "lqr", False),
    ("linear", "sac", False),
    ("laboratory", "lqg", True),
    ("laboratory", "tvc-dob", False),
    ("unknown-specimen", "apg", False),
    ("yielding", "lqr-integral", False),
]


@pytest.mark.parametrize(("scenario", "name", "supervised"), CASES)
def test_a_program_decides_as_python_does(scenario, name, supervised):
    scenario = make_scenario(scenario, {"duration": 1.0})
    program, controller = controller_program(name, scenario, supervised=supervised)
    decisions = record_decisions(to_float64(controller), scenario, noise_earthquakes(scenario, 3))
    assert_exact(action_differences(CompiledProgram(program), decisions))
    assert np.ptp(decisions.actions) > 1e-3
    if not supervised:
        assert (
            action_differences(CompiledProgram(replace(program, precision="float32")), decisions).max()
            < SINGLE
        )


@pytest.mark.parametrize("precision", ["float64", "float32"])
def test_in_the_loop_it_costs_what_the_python_controller_costs(precision):
    scenario = make_scenario("laboratory", {"duration": 2.0})
    program, controller = controller_program("lqg", scenario, precision=precision)
    earthquakes = noise_earthquakes(scenario, 3)
    ours, _ = rollout(CompiledController(program), scenario, earthquakes)
    theirs, _ = rollout(controller, scenario, earthquakes)
    for a, b in zip(ours, theirs, strict=True):
        assert a.cost == pytest.approx(b.cost, rel=1e-3)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A sanitized test program of tvc-dob in the laboratory, with its decisions."""
    folder = tmp_path_factory.mktemp("written")
    scenario = make_scenario("laboratory", {"duration": 1.0})
    program, controller = controller_program("tvc-dob", scenario)
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 2))
    inputs = decisions.observations[:50, 0].astype(float)
    write_program(program, folder, inputs, decisions.actions[:50].astype(float)[:, :1])
    return folder, program, decisions


@pytest.mark.parametrize("cc", COMPILERS)
def test_the_test_program_is_clean_under_sanitizers(written, cc):
    folder, program, decisions = written
    test = build_test(folder, program.name, SANITIZED, shutil.which(cc))
    checked = subprocess.run([str(test)], capture_output=True, text=True, check=False)
    assert checked.returncode == 0 and checked.stdout.startswith("ok: 50 periods"), checked.stderr
    codes, outputs = run_test_program([test], decisions.fresh[:, 1], decisions.observations[:, 1])
    assert not codes.any()
    assert_exact(np.abs(outputs[:, 0] - decisions.actions[:, 1]))


def test_a_wrong_recording_is_found(written, tmp_path):
    _, program, decisions = written
    inputs = decisions.observations[:50, 0].astype(float)
    actions = decisions.actions[:50].astype(float)[:, :1].copy()
    actions[30] += 1e-3
    write_program(program, tmp_path, inputs, actions)
    done = subprocess.run([str(build_test(tmp_path, program.name))], capture_output=True, text=True)
    assert done.returncode == 1 and done.stdout.startswith("WRONG")


@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
@pytest.mark.slow
def test_the_test_program_is_clean_under_valgrind(written):
    folder, program, decisions = written
    test = build_test(folder, program.name, ("-O1", "-g"))
    command = ["valgrind", "--error-exitcode=9", "--leak-check=full", "-q", test]
    codes, _ = run_test_program(command, decisions.fresh[:, 0], decisions.observations[:, 0])
    assert not codes.any()


def test_make_check_and_lib_work(written):
    folder, program, _ = written
    if shutil.which("make") is None:
        # The exported Makefile is for the target's tool chain; the package itself needs none.
        pytest.skip("make is not installed")
    done = subprocess.run(["make", "-s", "check", "lib"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0 and "ok" in done.stdout, done.stderr
    assert (folder / f"lib{program.name}.so").is_file()


def test_the_header_names_inputs_units_and_origin(written):
    folder, program, _ = written
    header = (folder / f"{program.name}.h").read_text(encoding="utf-8")
    assert "measured table_velocity [m/s]" in header and "current [A]" in header
    assert "digest 1:" in header and "shake-env" in header
    source = (folder / f"{program.name}.c").read_text(encoding="utf-8")
    assert "malloc" not in source and source.count("#include") == 3


# Observations that are not finite, and far out


@pytest.mark.parametrize("name", ["lqg", "pid", "apg"])
def test_what_is_not_finite_is_refused_and_the_rest_decided(name):
    scenario = make_scenario("laboratory")
    program, controller = controller_program(name, scenario)
    rows = random_observations(scenario, 600)
    finite = np.isfinite(rows).all(axis=1)
    assert 0.3 < finite.mean() < 0.7
    compiled = CompiledProgram(program)
    outputs, codes = compiled.step(compiled.begin(len(rows)), rows)
    np.testing.assert_array_equal(codes != 0, ~finite)
    assert not outputs[~finite].any()
    with np.errstate(all="ignore"):
        actions, _ = decide(to_float64(controller), rows)
    # Python refuses an action that is no number; what it takes is decided the same.
    assert np.isfinite(actions[finite]).all()
    assert_exact(np.abs(outputs[finite] - actions[finite]))


def test_a_refusal_leaves_the_memory_as_it_was():
    scenario = make_scenario("laboratory", {"duration": 1.0})
    program, controller = controller_program("lqg", scenario)
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 1))
    compiled = CompiledProgram(program)
    memory = compiled.begin(1)
    for observation in decisions.observations[:50]:
        compiled.step(memory, observation)
    before = memory.copy()
    bad = decisions.observations[50].copy()
    bad[0, 5] = np.nan
    output, codes = compiled.step(memory, bad)
    assert codes[0] == 1 and output[0, 0] == 0.0
    np.testing.assert_array_equal(memory, before)


def test_the_controller_says_that_it_refused():
    scenario = make_scenario("laboratory")
    controller = CompiledController(controller_program("pid", scenario)[0])
    with pytest.raises(ShakeError, match="observation"):
        controller.predict(np.full((1, scenario.observation.size), np.nan, np.float32))


def test_a_supervised_program_takes_every_observation_as_python_does():
    scenario = make_scenario("laboratory", {"duration": 1.0})
    program, controller = controller_program("pid", scenario, supervised=True)
    controller = to_float64(controller)
    rng = np.random.default_rng(3)
    decisions = record_decisions(
        make_baseline("pid", scenario), scenario, noise_earthquakes(scenario, 4)
    )
    compiled = CompiledProgram(program)
    memory, state, worst = compiled.begin(4), None, []
    for k, observation in enumerate(decisions.observations):
        shown = observation.copy()
        shown[rng.random(shown.shape) < 0.004] = rng.choice([np.nan, np.inf, -np.inf, 1e3])
        start = np.full(4, k == 0)
        with np.errstate(all="ignore"):
            action, state = decide(controller, shown, state, start)
        output, codes = compiled.step(memory, shown, start)
        assert not codes.any()
        worst.append(np.abs(output - action).max())
    assert controller.interventions(state).braked.sum() > 10
    assert_exact(np.array(worst))


# Networks with a memory that no shipped policy has, and the description itself


@pytest.mark.parametrize("unit", KINDS)
@pytest.mark.parametrize(
    ("direct", "activation", "output"), [(False, "tanh", "tanh"), (True, "relu", "clip")]
)
def test_every_network_is_exported(unit, direct, activation, output):
    rng = np.random.default_rng(0)

    def array(*shape):
        return rng.normal(0.0, 0.5, shape).astype(np.float32)

    scenario = make_scenario("linear", {"duration": 0.5})
    n, width = scenario.observation.size, 4 + 6
    policy = PolicyFile(
        matrix=array(4, n), feature_clip=1.5,
        weights=(array(8, width), array(1, 8 + (width if direct else 0))), biases=(array(8), array(1)),
        activation=activation, output=output, base=array(n) * np.float32(0.2), authority=0.5,
        card={"made": "here"}, direct=direct,
        memory=random_unit(unit, 4, 6),
    )  # fmt: skip
    decisions = record_decisions(to_float64(policy), scenario, noise_earthquakes(scenario, 2))
    program = as_program(policy, scenario, "made", "a made policy", {"made": 'by "a" test'})
    assert_exact(action_differences(CompiledProgram(program), decisions))
    single = CompiledProgram(replace(program, precision="float32"))
    assert action_differences(single, decisions).max() < SINGLE


@pytest.mark.parametrize("scenario", ["linear", "unknown-specimen"])
@pytest.mark.parametrize("masses", [Uniform(0.1, 1.0), None])
def test_the_adaptive_controller_is_exported(scenario, masses):
    uncertain = Uncertainty(mass_ratio=masses, storey_frequency=Uniform(5.0, 9.0))
    scenario = replace(make_scenario(scenario, {"duration": 1.0}), uncertainty=uncertain)
    controller = CertaintyEquivalence(scenario, SpecimenBank.from_scenario(scenario, 3, 2))
    decisions = record_decisions(controller, scenario, noise_earthquakes(scenario, 3))
    program = as_program(controller, scenario, "made", "certainty equivalence", {"made": "here"})
    assert_exact(action_differences(CompiledProgram(program), decisions))
    single = CompiledProgram(replace(program, precision="float32"))
    assert action_differences(single, decisions).max() < SINGLE
    assert np.ptp(decisions.actions) > 0.01


# Which controllers there are


SUITED = {
    **dict.fromkeys(("lqg", "lqg-dac", "dagger", "dagger-apg"), "laboratory"),
    **dict.fromkeys(("multi-model", "adaptive"), "unknown-specimen"),
    "dagger-apg-long": "field",
}  # a scenario of those that linear does not suit


@pytest.mark.parametrize("name", controllers())
def test_every_controller_is_exported_or_refused_with_its_reason(name):
    if name in NOT_EXPORTED:
        with pytest.raises(ScenarioError) as refused:
            controller_program(name, make_scenario("laboratory"))
        assert f"has no C form: it {NOT_EXPORTED[name]}" in str(refused.value)
        return
    scenario = make_scenario(SUITED.get(name, "linear"))
    if name == "lqr-friction-ff":
        with pytest.raises(ScenarioError, match="its filter steps the nonlinear model"):
            controller_program(name, make_scenario("laboratory"))
        scenario = make_scenario("linear", {"fields": {"nonlinearity.friction.coulomb": 300.0}})
    if name == "adaptive":  # one specimen's frequency, so that the design is short
        mass = Uncertainty(mass_ratio=Uniform(0.1, 1.0))
        scenario = replace(scenario, uncertainty=mass)
    texts = render_program(controller_program(name, scenario, prefix="made")[0])
    assert set(texts) == {"made.h", "made.c"}


SHIPPED = [(scenario, name) for scenario in NAMED for name in policies_trained_for(scenario)]


@pytest.mark.parametrize(("scenario", "name"), SHIPPED)
def test_every_shipped_policy_is_exported(scenario, name):
    program, _ = controller_program(name, make_scenario(scenario))
    assert program.provenance["policy"].startswith("sha256 ") and render_program(program)


def test_the_guide_names_every_controller_on_its_side():
    guide = (Path(__file__).parents[3] / "docs" / "howto" / "deploy.md").read_text(encoding="utf-8")
    rows = guide.split("| form in C |")[1].split("\n\n")[0].splitlines()
    refused = {name for row in rows if row.startswith("| no:") for name in re.findall("`(.*?)`", row)}
    named = {name for row in rows for name in re.findall("`(.*?)`", row)}
    assert refused == set(NOT_EXPORTED) and named == set(controllers())


def test_a_class_that_plans_is_refused():
    scenario = make_scenario("laboratory")
    with pytest.raises(ScenarioError, match="no C form"):
        block_of(make_baseline("mpc", scenario), scenario)


@pytest.mark.parametrize("value", [0.1, -1e-300, 3.0, 1e22, 0.0, 2.5e-8])
def test_a_constant_has_exactly_its_value(value):
    assert float(c_number(value)) == value
    assert np.float32(c_number(value, "float32").rstrip("F")) == np.float32(value)


# The table


@pytest.mark.parametrize("name", ["linear", "laboratory", "yielding", "unknown-specimen", "field"])
def test_the_exported_table_moves_as_the_simulated_one(name):
    scenario = make_scenario(name)
    program, model = plant_program(scenario), TableModel.from_scenario(scenario)
    compiled = CompiledProgram(program)
    memory, sensors = compiled.begin(1), model.measurement.rest(1)
    rows = floor_rows(scenario.plant, scenario.nonlinearity.yielding)
    state, rng, action = np.zeros((1, model.dynamics.states)), np.random.default_rng(0), 0.0
    ours, theirs = [], []
    for _ in range(400):
        action = float(np.clip(0.95 * action + 0.15 * rng.standard_normal(), -1.0, 1.0))
        response = model.dynamics.control_step(state, np.array([scenario.current_limit * action]))
        state = response.state
        acceleration, shear = response.table_acceleration[:, -1], response.base_shear[:, -1]
        floors = state[:, 4 : 4 + rows.shape[1]] @ rows.T
        row = [*state[0, [1, 2]], acceleration[0], *state[0, [0, 3]], shear[0], *floors[0]]
        if scenario.observation.reading_names:
            signals = model.measurement.signals(state, acceleration, shear, floors)
            readings, sensors = model.measurement.read(sensors, signals, 0.0 * signals, np.zeros(1))
            row += list(readings[0] * model.measurement.scale)
        theirs.append(row)
        ours.append(compiled.step(memory, np.array([[action]]))[0][0])
    ours, theirs = np.array(ours), np.array(theirs)
    assert np.max(np.abs(ours - theirs) / np.abs(theirs).max(axis=0)) < EXACT
    stroke = scenario.nonlinearity.stops.gap
    if np.isfinite(stroke):
        assert np.abs(ours[:, 0]).max() > stroke  # the stops were at work


def test_the_table_of_the_printed_equations_is_refused():
    with pytest.raises(ScenarioError, match="equations"):
        plant_program(make_scenario("as-printed"))


# All of it


SUPERVISED = ("laboratory", "unknown-specimen", "yielding", "field", "records")


@pytest.mark.slow
@pytest.mark.parametrize("scenario_name", NAMED)
@pytest.mark.parametrize("name", exported())
def test_ten_earthquakes_of_every_scenario(scenario_name, name):
    scenario = make_scenario(scenario_name)
    try:
        get_controller(name, scenario)
    except ShakeError as unsuited:
        # No controller of this name drives this table, so that there is nothing to export. What fails
        # in the export itself fails the test.
        pytest.skip(f"does not suit the scenario: {unsuited}")
    found = agreement(name, scenario)
    assert found.good, found
    assert found.checked == tuple(filter(shutil.which, ("gcc", "clang", "valgrind")))


@pytest.mark.slow
@pytest.mark.parametrize("scenario_name", SUPERVISED)
def test_the_supervisor_on_ten_earthquakes(scenario_name):
    scenario = make_scenario(scenario_name)
    name = "preview-lqr" if scenario.sensing.full_state else "lqg"
    found = agreement(name, scenario, supervised=True)
    assert found.good, found
