"""A sequence: forecast, shake, update; what is unsafe or of another test is refused; it goes on."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from rich.console import Console
from small_sequence import begun, laboratory_test

from agents.cli.commands import parse
from agents.laboratory.identification import calibration
from agents.laboratory.identification.damage import damage_after
from agents.laboratory.identification.identify import identify
from agents.laboratory.result_files import ResultFile, laboratory_tables
from agents.laboratory.sequence.rehearsal import (
    hidden_truth,
    rehearsal_summary,
    rehearse_sequences,
    simulate_shake,
)
from agents.laboratory.sequence.state import read_sequence
from agents.laboratory.sequence.steps import close_shake, designed_on, next_shake, plan_sequence
from shake_env.errors import FileError, LogError, ParameterError, ShakeError
from shake_env.model.specimen_state import NEW
from shake_env.scenario.overrides import make_scenario
from shake_env.scenario.scenario_file import read_scenario
from shake_env.simulation.simulation import Simulation
from shake_env.simulation.streams import earthquake_stream


def test_a_sequence_goes_from_plan_to_last_shake(tmp_path):
    folder = tmp_path / "one"
    begun(folder)
    truth = hidden_truth(laboratory_test(), np.random.default_rng(3), wider=False)
    widths = [read_sequence(folder).posterior.points.std(axis=0)]
    for number in (1, 2):
        sequence, forecasts = next_shake(read_sequence(folder))
        assert [each.controller for each in forecasts] == ["lqg"]
        assert (folder / f"shake_{number}" / "forecast.html").exists()
        design = designed_on(sequence)
        assert read_scenario(folder / f"shake_{number}" / "test.toml").specimen == design.specimen
        log, outcomes, _ = simulate_shake(design, truth, "lqg", number)
        assert not outcomes.broken.any()
        sequence, _ = close_shake(read_sequence(folder), log)
        widths.append(sequence.posterior.points.std(axis=0))
        with pytest.raises((LogError, ParameterError)):
            close_shake(read_sequence(folder), log)
    names = sequence.posterior.names
    for before, after in pairwise(widths):
        at = names.index("coulomb_friction")
        assert after[at] < before[at]
    assert sequence.number == 2
    assert len(sequence.posterior.logs) == 2
    assert 0.4 < sequence.calibration <= 1.0
    with pytest.raises(ParameterError, match="all 2 shakes are done"):
        next_shake(read_sequence(folder))


def test_an_unsafe_shake_is_refused_unless_overridden(tmp_path):
    scenario = laboratory_test()
    scenario = replace(scenario, limits=replace(scenario.limits, table_displacement=0.003))
    plan_sequence(tmp_path / "one", scenario, amplitudes=(1.0,), samples=8)
    with pytest.raises(ParameterError, match=r"is unsafe: no controller keeps every limit.*--override"):
        next_shake(read_sequence(tmp_path / "one"))
    with pytest.raises(ParameterError, match="is unsafe"):  # a blank is no reason
        next_shake(read_sequence(tmp_path / "one"), override=" ")
    assert read_sequence(tmp_path / "one").next.forecast is None
    next_shake(read_sequence(tmp_path / "one"), override="a test of the limits")
    assert read_sequence(tmp_path / "one").next.override == "a test of the limits"


def test_what_is_out_of_order_is_refused(tmp_path):
    sequence = begun(tmp_path / "one")
    truth = hidden_truth(laboratory_test(), np.random.default_rng(1), wider=False)
    log, _, _ = simulate_shake(designed_on(sequence), truth, "lqg", 1)
    with pytest.raises(ParameterError, match="has no forecast yet"):
        close_shake(sequence, log)
    with pytest.raises(ParameterError, match="holds a sequence already"):
        begun(tmp_path / "one")
    with pytest.raises(ParameterError, match="must rise"):
        plan_sequence(tmp_path / "two", laboratory_test(), amplitudes=(0.5, 0.5))
    with pytest.raises(FileError, match="begin with shake sequence plan"):
        read_sequence(tmp_path / "none")
    (tmp_path / "one" / "sequence.json").write_text("{}")
    with pytest.raises(FileError, match="damaged"):
        read_sequence(tmp_path / "one")


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("required_probability", 2.0, "must lie between 0 and 1"),
        ("required_probability", float("nan"), "must lie between 0 and 1"),
        ("seed", -1, "must not be negative"),
        ("samples", 1, "must be 2 to 100 000"),
        ("controllers", (), "name at least one"),
        ("controllers", ("lgq",), "did you mean 'lq"),
    ],
)
def test_a_plan_that_no_shake_could_follow_is_refused(tmp_path, name, value, words):
    with pytest.raises(ShakeError, match=words):
        plan_sequence(tmp_path / "one", laboratory_test(), **{name: value})
    assert not (tmp_path / "one").exists()


def test_a_shake_is_closed_by_a_log_of_its_own_table_and_options_that_mean_something(tmp_path):
    begun(tmp_path / "one")
    sequence, _ = next_shake(read_sequence(tmp_path / "one"), page=False)
    design = designed_on(sequence)
    truth = hidden_truth(laboratory_test(), np.random.default_rng(1), wider=False)
    other = replace(design, actuator=replace(design.actuator, piston_area=2e-3))
    for model, words in (
        (other, "of another table: expected"),
        (replace(make_scenario("laboratory", {"stories": 3}), motion=design.motion), "another specimen"),
    ):
        log, _, _ = simulate_shake(model, model, "lqg", 1)
        with pytest.raises(LogError, match=words):
            close_shake(sequence, log)
    log, _, _ = simulate_shake(design, truth, "lqg", 1)
    for options, words in (
        ({"band": (300.0, 400.0)}, "none of the log's frequencies"),
        ({"band": (40.0, 0.2)}, "none of the log's frequencies"),
        ({"band": (float("nan"), 1.0)}, "none of the log's frequencies"),
        ({"without": ("foo",)}, "known: "),
    ):
        with pytest.raises(ParameterError, match=words):
            close_shake(sequence, log, **options)
    closed, _ = close_shake(sequence, log, without=("table_acceleration",))
    assert "table_acceleration_peak" not in closed.shakes[0].measured
    assert "table_velocity_peak" in closed.shakes[0].measured
    with pytest.raises(LogError, match="given twice"):
        identify([log, log], design)
    with pytest.raises(ParameterError, match="sampler_seconds"):
        identify([log], design, sampler_seconds=-1.0)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("amplitude", "x"), ("inside", 5), ("inside", {"a": "x"}), ("forecast", {}),
        ("forecast", {"intervals": {"table_displacement_rms": "abc"}}), ("log", ["only a name"]),
    ],
)  # fmt: skip
def test_a_damaged_state_is_refused_where_it_is_read(tmp_path, field, value):
    begun(tmp_path / "one")
    file = tmp_path / "one" / "sequence.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    read_sequence(tmp_path / "one")
    content["shakes"][0][field] = value
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(FileError, match="is damaged"):
        read_sequence(tmp_path / "one")


def test_a_hidden_truth_lies_outside_of_the_model():
    scenario = laboratory_test()
    stream = np.random.default_rng(0)
    truth = hidden_truth(scenario, stream)
    assert truth.specimen.coupled  # Rayleigh damping
    assert len(set(truth.specimen.stiffnesses)) == 2
    friction = truth.nonlinearity.friction
    assert friction.static > friction.coulomb
    assert truth.nonlinearity.valve.natural_frequency is not None
    assert truth.nonlinearity.valve.supply_pressure < scenario.nonlinearity.valve.supply_pressure
    assert truth.observation.names == scenario.observation.names


def yielding_bed(seconds=3.0):
    """Two storeys that yield from 4 mm on; the yield drift is uncertain as everything else is."""
    scenario = laboratory_test(seconds)
    yielding = replace(scenario.nonlinearity.yielding, yield_drift=4e-3)
    # A preview has the reference computed beyond the motion's end; its slip is compared here.
    sensing = replace(scenario.sensing, preview=0.0)
    parts = replace(scenario.nonlinearity, yielding=yielding)
    return replace(scenario, nonlinearity=parts, sensing=sensing)


def test_damage_follows_from_the_logs():
    """Told the truth's parameters, the damage after two shakes is the truth's."""
    scenario = yielding_bed()
    truth = hidden_truth(scenario, np.random.default_rng(2), wider=False)
    specimen, logs = NEW, []
    for number in (1, 2):
        log, outcomes, specimen = simulate_shake(scenario, truth, "lqg", number, specimen)
        assert not outcomes.broken.any()
        logs.append(log)
    assert np.abs(specimen.slip).max() > 1e-4
    other = truth.with_plant({"yield_drift": 5e-3})
    same, elastic = damage_after([truth, other], logs)
    assert same.slip == pytest.approx(specimen.slip, rel=1e-9)
    assert same.energy == pytest.approx(specimen.energy, rel=1e-9)
    # A log holds the target at the control rate; filtered noise has more than half of that rate shows.
    assert same.reference_slip == pytest.approx(specimen.reference_slip, abs=5e-5)
    assert same.reference_energy == pytest.approx(specimen.reference_energy, rel=0.06)
    assert elastic.energy != pytest.approx(same.energy, rel=1e-3)
    (once,) = damage_after([truth], logs[:1])
    assert once.energy < same.energy
    # Each lane's own yield drift, as alone.
    (alone,) = damage_after([other], logs)
    assert alone.slip == pytest.approx(elastic.slip, rel=1e-6, abs=1e-9)
    assert alone.reference_slip == pytest.approx(elastic.reference_slip, rel=1e-6, abs=1e-9)
    assert damage_after([laboratory_test()], logs) == [NEW]


def test_damage_is_part_of_the_belief(tmp_path):
    scenario = yielding_bed()
    folder = tmp_path / "one"
    plan_sequence(folder, scenario, amplitudes=(0.8, 1.0), samples=12, required_probability=0.1)
    truth = hidden_truth(scenario, np.random.default_rng(4), wider=False)
    sequence, _ = next_shake(read_sequence(folder), override="a test")
    log, _, specimen = simulate_shake(designed_on(sequence), truth, "lqg", 1)
    close_shake(read_sequence(folder), log)
    sequence = read_sequence(folder)
    damage = sequence.shakes[0].damage
    low, middle, high = damage["dissipated_energy"]
    assert low <= middle <= high
    assert middle == pytest.approx(specimen.energy, rel=0.1)
    assert damage["storey_slip_1"][1] == pytest.approx(specimen.slip[0], rel=0.1, abs=2e-4)
    posterior = sequence.posterior
    assert len(posterior.states) == len(posterior.points)
    # The next forecast begins on damaged samples.
    simulation = Simulation(posterior.uncertain, 4)
    simulation.start(range(4), [earthquake_stream(i) for i in range(4)])
    assert np.abs(simulation.first_drifts[0]).max() > 1e-5
    sequence, _ = next_shake(sequence, override="a test")
    assert sequence.next.forecast is not None


def test_a_rehearsal_goes_on_from_its_result_file(tmp_path):
    file = tmp_path / "out.json"
    line = (
        "sequence rehearse --scenario laboratory --truths 1 --amplitudes 1 --samples 4 --quiet "
        f"--well-specified --output {file}"
    )
    row = {
        "truth": 0, "values": {}, "inside": {"1 energy": True}, "errors": [0.2], "informed": 0.2,
        "nominal": 0.4, "limits_broken": 0, "overridden": 0, "damage": 1.5, "iteration_damage": 6.5,
        "iteration_error": 0.1, "failure": None,
    }  # fmt: skip
    options = {
        "seed": 0, "amplitudes": (1.0,), "controllers": ("lqg",), "samples": 4, "wider": False,
        "discrepancy": True,
    }  # fmt: skip
    made = ResultFile(file, "shake sequence rehearse", make_scenario("laboratory"), options)
    made.write_rows([row])
    result = parse(line.split()).run(Console(quiet=True))  # nothing is left to do
    assert result["truths"] == 1 and result["error_over_nominal"] == [0.5, 0.5, 0.5]
    assert json.loads(file.read_text())["rows"] == [row]
    text = laboratory_tables_of(file, tmp_path)
    assert "| from the prior | yes | 100 % | 1.00 [1.00, 1.00] |" in text
    assert "6.50 [6.50, 6.50] and 0.10 [0.10, 0.10] with a transfer-function iteration" in text
    other = parse(line.replace("--samples 4", "--samples 5").split())
    with pytest.raises(FileError, match="another options"):
        other.run(Console(quiet=True))
    made.write_rows([{key: value for key, value in row.items() if key != "damage"}])
    with pytest.raises(FileError, match=r"another version \(.*damage"):
        parse(line.split()).run(Console(quiet=True))
    file.write_text("[]")
    with pytest.raises(FileError, match="no result of this study"):
        parse(line.split()).run(Console(quiet=True))


def laboratory_tables_of(file, folder):
    file.replace(folder / "laboratory_a.json")
    text = laboratory_tables(folder)
    (folder / "laboratory_a.json").replace(file)
    return text


@pytest.mark.slow
def test_a_rehearsal_on_the_fitted_model_is_calibrated():
    found = rehearse_sequences(
        laboratory_test(8.0), truths=3, amplitudes=(0.25, 1.0), samples=60, wider=False, seed=1
    )
    result = rehearsal_summary(found)
    assert result["failed"] == []
    assert result["limits_broken"] == 0
    assert result["coverage"] > 0.75
    assert result["error_over_informed"][1] < 1.3


def test_the_command_plans_and_says_where_it_stands(tmp_path):
    folder = tmp_path / "one"
    line = f"sequence plan --scenario unknown-specimen --folder {folder} --samples 4 --quiet"
    state = parse(line.split()).run(Console(quiet=True))
    assert state["done"] == 0
    assert [each["amplitude"] for each in state["shakes"]] == [0.1, 0.25, 0.5, 0.75, 1.0]
    state = parse(f"sequence status --folder {folder}".split()).run(Console(quiet=True))
    assert state["calibration"] is None
    with pytest.raises(ParameterError, match="log"):
        parse(f"sequence close --folder {folder}".split()).run(Console(quiet=True))


def test_results_of_several_tests_are_one_table_of_what_each_tells(tmp_path):
    def result(drive, without, error):
        names = ("specimen_mass", "storey_stiffness_1", "storey_stiffness_2")
        row = {"ranks": [1, 2, 3], "errors": [error, -error, error], "widths": [0.1] * 3, "seconds": 1.0}
        options = {"seconds": 8.0, "amplitude": 0.1, "without": without, "controller": drive}
        head = {"command": "shake calibrate", "scenario": "laboratory", "options": options}
        return {**head, **calibration.calibration_summary(names, [row, row], 10)}

    for stem, *arguments in (
        ("laboratory_calibration", "none", [], 0.01),
        ("laboratory_test_a", "lqg", ["load_pressure"], 0.0234),
    ):
        (tmp_path / f"{stem}.json").write_text(json.dumps(result(*arguments)))
    text = laboratory_tables(tmp_path)
    assert "laboratory_test_a" not in text  # a row of the last table, and none of its own
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| `laboratory`")]
    assert [row[1] for row in rows] == ["noise of current", "filtered noise under `lqg`"]
    assert [row[4] for row in rows] == ["-", "`load_pressure`"]
    assert rows[1][6:] == ["2.3 %", "2.3 %", "2.3 % |"]
