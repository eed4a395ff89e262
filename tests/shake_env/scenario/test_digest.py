"""A scenario's digest: of all that it is but its name, the same on every machine."""

import math
import subprocess
import sys
from dataclasses import fields, replace

import numpy as np
import pytest

from shake_env import Record, make_scenario
from shake_env.motion.targets import FilteredNoise, RecordedMotion
from shake_env.records import load_record
from shake_env.scenario import digest as scenario_digest
from shake_env.scenario.digest import scenario_digest as digest
from shake_env.scenario.scenario import Scenario

# Written down, so that another platform, Python or canonical form shows. Who changes a scenario on
# purpose tunes it again; a field that joins a part goes into `scenario_digest.ADDED_FIELDS`.
KNOWN = {
    "linear": "1:70922dbd7faba8ab018f5e2039ee6bc1",
    "as-printed": "1:3419294be51bc151b12be015499507c8",
    "laboratory": "1:a3582603ffc18270c78ab8bf877a09c3",
    "unknown-specimen": "1:3f163bb059641cd05ebf3238a4d35ff3",
    "yielding": "1:cea78752ed51f8fcb405ce8c5fcfa21b",
}


@pytest.mark.parametrize("name", KNOWN)
def test_named_scenarios_have_the_digests_written_down(name):
    assert digest(make_scenario(name)) == KNOWN[name]


def test_the_previews_spacing_counts_by_what_is_shown():
    def spaced(spacing, name="laboratory", **fields):
        return digest(make_scenario(name, {"fields": {"sensing.preview_spacing": spacing, **fields}}))

    assert spaced(0.001) == digest(make_scenario("laboratory")) != spaced(0.005)
    assert (
        spaced(0.005, "yielding") == "1:f37d69f16cd03be8bbe6b0d724c8b120"
    )  # as before 1 ms was the default
    assert spaced(0.005, "linear") == KNOWN["linear"]  # without a preview it shows nothing


def test_the_name_is_not_in_it():
    scenario = make_scenario("laboratory")
    assert digest(replace(scenario, name="mytable")) == digest(scenario)


def test_the_length_of_filtered_noise_is_not_in_it():
    longer = make_scenario("laboratory", {"duration": 47.0})
    assert longer != make_scenario("laboratory")
    assert digest(longer) == digest(make_scenario("laboratory"))


def test_every_other_field_of_a_scenario_is_in_it():
    changes = {
        "actuator.table_mass": 500.0, "specimen.masses": [1.0, 2.0], "ground.frequency": 1.3,
        "equations.reaction_on_table": False, "motion.amplitude": 0.3, "objective.force_weight": 2.0,
        "physics_step": 5e-4, "control_rate": 250.0, "noise_directions": 3, "current_limit": 0.05,
        "limits.table_displacement": 0.07, "nonlinearity.friction.coulomb": 151.0, "delay": 3.0,
        "uncertainty.mass_ratio": [0.2, 0.3], "sensing.sensors.load_pressure.noise": 1.0,
    }  # fmt: skip
    assert {path.partition(".")[0] for path in changes} == {
        field.name for field in fields(Scenario) if field.name not in ("name", "train_on", "table")
    }
    base = "laboratory"
    for path, value in changes.items():
        name = "linear" if path.startswith("equations") else base
        changed = make_scenario(name, {"fields": {path: value}})
        assert digest(changed) != digest(make_scenario(name)), path


def test_how_a_number_is_written_does_not_count():
    scenario = make_scenario("laboratory")
    same = replace(scenario, delay=np.float64(scenario.delay), current_limit=np.float64(0.04))
    assert digest(same) == digest(scenario)
    ulp = replace(scenario, current_limit=math.nextafter(0.04, 1.0))
    assert ulp != scenario and digest(ulp) == digest(scenario)
    assert digest(replace(scenario, delay=2)) == digest(replace(scenario, delay=2.0))
    assert digest(replace(scenario, current_limit=0.04001)) != digest(scenario)


def test_a_record_counts_by_its_samples():
    record = load_record("napa2014_68150_hne")
    by_name = make_scenario("linear", {"motion": RecordedMotion(record="napa2014_68150_hne")})
    same = replace(by_name, motion=RecordedMotion(record=replace(record, name="mine")))
    assert digest(same) == digest(by_name)
    other = Record("napa2014_68150_hne", 1.01 * record.acceleration, record.sampling_interval, ())
    assert digest(replace(by_name, motion=RecordedMotion(record=other))) != digest(by_name)
    assert digest(replace(by_name, motion=FilteredNoise())) != digest(by_name)


def test_a_field_that_joined_later_is_left_out_at_its_neutral_value(monkeypatch):
    linear, other = make_scenario("linear"), make_scenario("linear", {"delay": 1.0})
    before = digest(linear)
    monkeypatch.setattr(scenario_digest, "ADDED_FIELDS", {"delay": 0})
    assert digest(linear) != before  # as it would have been without the field
    assert digest(other) not in (before, digest(linear))


def test_it_does_not_depend_on_the_hash_seed():
    code = (
        "from shake_env import make_scenario; from shake_env.scenario.digest import scenario_digest; "
        "print(scenario_digest(make_scenario('laboratory')))"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={"PYTHONHASHSEED": "7"},
    )  # fmt: skip
    assert run.stdout.strip() == KNOWN["laboratory"]
