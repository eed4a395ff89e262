"""A motion planned before its test: close to the optimum, also where the table differs a little."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from baselines.planning.bound import optimal_episodes
from baselines.planning.episodes import driven, episodes
from baselines.planning.planned import (
    ARRAYS,
    PlannedControl,
    RecordPlan,
    nominal_reference,
    plan_records,
)
from baselines.registry import make_baseline
from shake_env import make_scenario
from shake_env.errors import FileError, ParameterError
from shake_env.model.plant import TABLE_DISPLACEMENT
from shake_env.rollout import noise_earthquakes, recorded_earthquakes, rollout


@pytest.fixture(scope="module")
def planned():
    scenario = make_scenario("laboratory", {"duration": 5.0})
    quakes = noise_earthquakes(scenario, 2, 4_000_000)
    return scenario, quakes, plan_records(scenario, quakes)


def test_on_the_planned_table_it_nearly_costs_the_optimum(planned):
    scenario, quakes, plans = planned
    least = np.array([each.cost for each in optimal_episodes(scenario, quakes)])
    assert [plan.cost for plan in plans] == pytest.approx(least, rel=0.01)
    # The model is the truth: the filter need not expect disturbances.
    trusting = PlannedControl(scenario, plans, model_error_scale=0.01)
    _, costs, lost = driven(trusting, scenario, quakes)
    assert not any(lost)
    assert (least <= costs).all() and (np.array(costs) < 1.05 * least).all()


def test_feedback_keeps_the_plan_on_a_table_that_differs(planned):
    scenario, quakes, plans = planned
    friction = replace(scenario.nonlinearity.friction, coulomb=180.0)
    actuator = replace(scenario.actuator, bulk_modulus=0.95 * scenario.actuator.bulk_modulus)
    nonlinearity = replace(scenario.nonlinearity, friction=friction)
    other = replace(scenario, nonlinearity=nonlinearity, actuator=actuator)
    law = PlannedControl(scenario, plans)
    rows = rollout(law, other, quakes)[0]
    reference = rollout(make_baseline("lqg", scenario), other, quakes)[0]
    assert not any(row.broken_limit for row in rows)
    assert np.mean([row.cost for row in rows]) < np.mean([row.cost for row in reference])


@pytest.mark.parametrize("name", ["records", "yielding"])
def test_the_nominal_reference_is_the_environments(name):
    """Of a record, which runs straight between its samples, and of a specimen that yields."""
    scenario = make_scenario(name, {"duration": 2.0} if name == "yielding" else {})
    recorded = name == "records"
    quakes = recorded_earthquakes(scenario) if recorded else noise_earthquakes(scenario, 1, 3)
    (episode,) = episodes(scenario, quakes[:1])
    ours = nominal_reference(scenario, episode.target)
    np.testing.assert_allclose(ours, episode.shear, atol=1e-9 * np.abs(episode.shear).max())


def test_feedback_holds_the_displacement_and_the_plan_does_not_depend_on_it(planned):
    """Without it nothing returns a table to its plan: three of six records ended at the stroke."""
    scenario, quakes, plans = planned
    (free,) = plan_records(scenario, quakes[:1], displacement_tolerance=None)
    np.testing.assert_array_equal(free.current, plans[0].current)
    held, loose = (np.median(plan.gain[:, TABLE_DISPLACEMENT]) for plan in (plans[0], free))
    assert held < 0.0 and abs(loose) < 0.1 * abs(held)


@pytest.mark.slow
def test_no_record_is_lost():
    scenario = make_scenario("records")
    quakes = recorded_earthquakes(scenario)
    plans = plan_records(scenario, quakes)
    rows = rollout(PlannedControl(scenario, plans), scenario, quakes)[0]
    assert not any(row.broken_limit for row in rows)
    assert sum(row.cost for row in rows) < 1.25 * sum(plan.cost for plan in plans)


def test_a_plan_is_read_as_it_was_written(planned, tmp_path):
    plan = planned[2][0]
    plan.write(tmp_path / "plan.npz")
    again = RecordPlan.read(tmp_path / "plan.npz")
    assert (again.name, again.digest, again.cost) == (plan.name, plan.digest, plan.cost)
    assert all(np.array_equal(getattr(again, each), getattr(plan, each)) for each in ARRAYS)


def tiny_plan():
    return RecordPlan(
        "tiny", "1:0", 1.0, np.ones(3), np.ones((4, 9)), np.ones((3, 10)), np.ones((3, 9)),
        np.ones((3, 5)), np.ones((3, 5)),
    )  # fmt: skip


def test_what_is_no_whole_plan_is_refused_with_file_and_remedy(tmp_path):
    tiny_plan().write(tmp_path / "plan.npz")
    whole = (tmp_path / "plan.npz").read_bytes()
    rng = np.random.default_rng(0)
    damaged = [b"", b"no plan", *(whole[:n] for n in range(1, len(whole), 97))]
    for _ in range(300):
        changed = bytearray(whole)
        for place in rng.integers(len(whole), size=3):
            changed[place] ^= int(rng.integers(1, 256))
        damaged.append(bytes(changed))
    np.save(tmp_path / "one.npy", np.ones(3))
    damaged.append((tmp_path / "one.npy").read_bytes())
    refused = 0
    for content in damaged:
        (tmp_path / "other.npz").write_bytes(content)
        try:
            RecordPlan.read(tmp_path / "other.npz")  # a changed date or attribute harms nothing
        except FileError as error:
            refused += 1
            assert "other.npz" in str(error) and "by shake plan" in error.remedy
    assert refused > 0.8 * len(damaged)
    with pytest.raises(FileError, match="shake plan"):
        RecordPlan.read(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"current": np.ones(2)}, "state has shape"),
        ({"gain": np.ones((3, 8))}, "gain has shape"),
        ({"response": np.ones((3, 5))}, "response has shape"),
        ({"shear": np.full((3, 5), np.nan)}, "no finite numbers"),
        ({"current": np.ones((3, 1))}, "other dimensions"),
    ],
)
def test_arrays_that_do_not_fit_together_are_no_plan(tmp_path, changes, words):
    replace(tiny_plan(), **changes).write(tmp_path / "plan.npz")
    with pytest.raises(FileError, match=words):
        RecordPlan.read(tmp_path / "plan.npz")


def test_a_plan_is_played_with_other_sensors_preview_and_motions(planned):
    _, quakes, plans = planned
    for name, fields in (
        ("records", {}),
        ("laboratory", {"sensing.preview_spacing": 0.005, "sensing.preview": 0.05}),
        ("field", {}),
    ):
        other = make_scenario(name, {"fields": fields})
        if name == "field":  # its nominal table is another one
            with pytest.raises(ParameterError, match="another table"):
                PlannedControl(other, plans)
            continue
        PlannedControl(other, plans)
    # With the full state shown, the estimate, and so the feedback, is as good.
    seen = make_scenario("laboratory", {"duration": 5.0, "sensing": "full"})
    costs = driven(PlannedControl(seen, plans), seen, quakes)[1]
    assert (np.array(costs) < 1.1 * np.array([plan.cost for plan in plans])).all()


def test_a_plan_is_of_one_table(planned):
    scenario, _, plans = planned
    other = replace(scenario, current_limit=0.03)
    with pytest.raises(ParameterError, match="another table"):
        PlannedControl(other, plans)
    law = PlannedControl(scenario, plans)
    with pytest.raises(ParameterError, match="plans for 2"):
        law.predict(np.zeros((3, scenario.observation.size), dtype=np.float32))
