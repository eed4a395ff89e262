"""Bounds are computed once: what is kept, what makes it another bound, and what happens without it."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("numba")

from agents.evaluation import bound_store
from agents.evaluation.bound_store import cache_folder, earthquake_bounds
from baselines.planning.bound import optimal_episodes
from shake_env import make_scenario
from shake_env.rollout import noise_earthquakes

SHORT = {"duration": 0.5}


@pytest.fixture
def searched(monkeypatch, tmp_path):
    """Names of the earthquakes that are searched, with a cache of the test's own."""
    monkeypatch.setenv("SHAKE_ENV_CACHE", str(tmp_path / "cache"))
    names = []

    def optima(scenario, earthquakes, **options):
        names.extend(quake.name for quake in earthquakes)
        return optimal_episodes(scenario, earthquakes, **options)

    monkeypatch.setattr(bound_store, "optimal_episodes", optima)
    return names


def test_a_bound_is_computed_once(searched):
    scenario = make_scenario("laboratory", SHORT)
    quakes = noise_earthquakes(scenario, 4, 4_000_000)
    first = earthquake_bounds(scenario, quakes[:2])
    assert searched == ["noise 4000000", "noise 4000001"]
    assert first.costs == pytest.approx(
        [each.cost for each in optimal_episodes(scenario, quakes[:2])], rel=1e-9
    )
    shares = []
    again = earthquake_bounds(scenario, [*quakes, quakes[3]], on_progress=shares.append)
    assert searched == [f"noise 400000{i}" for i in range(4)]  # a copy of one is not searched twice
    assert again.episodes[:2] == first.episodes and again.episodes[3] == again.episodes[4]
    assert shares[-1] == 1.0 and shares == sorted(shares)
    assert len(list((cache_folder() / "bounds").iterdir())) == 4


def test_what_the_current_cannot_reach_is_no_other_bound(searched):
    scenario = make_scenario("laboratory", SHORT)
    quakes = noise_earthquakes(scenario, 1, 4_000_000)
    costs = earthquake_bounds(scenario, quakes).costs
    finer = make_scenario("laboratory", {**SHORT, "fields": {"sensing.preview_spacing": 0.001}})
    assert earthquake_bounds(replace(finer, name="mine"), quakes).costs == pytest.approx(costs)
    assert len(searched) == 1
    dearer = make_scenario("laboratory", {**SHORT, "fields": {"objective.force_weight": 2.0}})
    assert earthquake_bounds(dearer, quakes).costs != pytest.approx(costs)
    weaker = make_scenario("laboratory", {**SHORT, "fields": {"nonlinearity.friction.coulomb": 0.0}})
    assert earthquake_bounds(weaker, quakes).costs != pytest.approx(costs)
    assert len(searched) == 3


def test_damaged_and_absent_caches_cost_only_time(searched, monkeypatch, tmp_path):
    scenario = make_scenario("linear", SHORT)
    quakes = noise_earthquakes(scenario, 1, 4_000_000)
    costs = earthquake_bounds(scenario, quakes).costs
    (file,) = (cache_folder() / "bounds").iterdir()
    for text in ("", "{}", '{"cost": 1.0, "starts": [{"no": 1}]}', "\x00"):
        file.write_text(text)
        assert np.array_equal(earthquake_bounds(scenario, quakes).costs, costs)
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("SHAKE_ENV_CACHE", str(tmp_path / "file"))  # where no folder can be
    assert np.array_equal(earthquake_bounds(scenario, quakes).costs, costs)
    assert len(searched) == 6


def test_an_earthquake_that_is_too_strong_for_the_starting_laws_is_searched_from_gentler_ones(searched):
    smooth = {"nonlinearity.friction.coulomb": 0.0}  # the search then needs no smoother plants
    scenario = make_scenario("laboratory", {"duration": 1.5, "amplitude": 40.0, "fields": smooth})
    quakes = noise_earthquakes(scenario, 1, 4_000_000)
    found = earthquake_bounds(scenario, quakes)
    assert not found.reason and np.isfinite(found.costs).all()
    (episode,) = found.episodes
    assert len(episode.starts) == 5 and sum(start.feasible for start in episode.starts) >= 2
    assert found.costs[0] == min(start.cost for start in episode.starts if start.feasible)
    assert episode.seconds == sum(start.seconds for start in episode.starts)
    number = len(searched)
    assert earthquake_bounds(scenario, quakes).episodes == found.episodes and len(searched) == number


def test_earthquakes_that_no_current_survives_are_named(monkeypatch):
    scenario = make_scenario("laboratory", SHORT)
    quakes = noise_earthquakes(scenario, 7, 4_000_000)
    fine, lost = bound_store.EpisodeBound(1.0, ()), bound_store.EpisodeBound(np.inf, ())
    monkeypatch.setattr(bound_store, "_batch", lambda *given: [fine, *[lost] * 6])
    found = earthquake_bounds(scenario, quakes)
    assert not found.episodes
    assert "on noise 4000001, noise 4000002" in found.reason and "4000005 and 1 more" in found.reason
    assert "smaller amplitude" in found.reason


def test_without_numba_there_is_a_reason(monkeypatch):
    monkeypatch.setattr("baselines.planning.model.compiled_module", lambda name: None)
    scenario = make_scenario("linear", SHORT)
    found = earthquake_bounds(scenario, noise_earthquakes(scenario, 1, 1))
    assert not found.episodes and "planning needs it" in found.reason
