"""The search space of an experiment: every draw is a valid run, and its own values are among them."""

import json
import math
from dataclasses import replace

import optuna
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from small_experiment import SMALL, TINY

from agents.experiments.catalogue import EXPERIMENTS
from agents.experiments.recipes import ExperimentConfig
from agents.experiments.search import find_experiment
from agents.experiments.search_objective import (
    ValidationSet,
)
from agents.experiments.search_space import (
    Choice,
    Range,
    own_values,
    search_space,
    suitable_laws,
    trial_config,
)
from agents.seeds import EVALUATION_SEED, TEST_SEED
from agents.training.algorithm_options import PPOOptions
from agents.training.config import TrainConfig, config_of
from shake_env.errors import ParameterError


@pytest.mark.parametrize("experiment", EXPERIMENTS, ids=lambda experiment: experiment.name)
def test_whatever_is_drawn_is_a_valid_run_and_the_recipe_is_among_it(experiment):
    knobs, own = search_space(experiment), own_values(experiment)
    start = trial_config(experiment, {knob.name: own[knob.name] for knob in knobs}, 1.0)
    assert start.chosen == experiment.config.chosen
    assert (start.steps, start.lookahead) == (experiment.config.steps, experiment.config.lookahead)
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=1))
    drawn = set()
    for _ in range(25):
        trial = study.ask()
        values = {knob.name: knob.suggest(trial) for knob in knobs}
        config = trial_config(experiment, values, 0.3)  # its own checks are TrainConfig's
        assert config_of(json.loads(json.dumps(config.to_json()))) == config
        assert config.steps == math.ceil(0.3 * experiment.config.steps)
        assert config.scenario == experiment.config.scenario
        drawn.add(json.dumps(config.to_json()))
    assert len(drawn) == 25
    for knob in knobs:
        if isinstance(knob, Range):
            assert knob.low <= own[knob.name] <= knob.high
        else:
            assert own[knob.name] in knob.values and len(knob.values) > 1


@settings(max_examples=60, deadline=None)
@given(tables=st.integers(1, 300), length=st.integers(1, 300), data=st.data())
def test_a_batch_divides_every_roll_out(tables, length, data):
    samples = tables * length
    parts = data.draw(st.sampled_from([n for n in range(1, 17) if samples % n == 0]))
    options = PPOOptions(n_envs=tables, n_steps=length, batch_size=samples // parts)
    experiment = ExperimentConfig(evaluation_task="linear", config=TrainConfig(ppo=options), minutes=1.0)
    knobs = {knob.name: knob for knob in search_space(experiment)}
    for steps in knobs["n_steps"].values:
        for pieces in knobs["minibatches"].values:
            config = trial_config(experiment, {"n_steps": steps, "minibatches": pieces}, 1.0)
            assert config.ppo.batch_size * pieces == tables * steps
    own = own_values(experiment)
    assert trial_config(experiment, {n: own[n] for n in knobs}, 1.0).ppo == options


def test_a_search_keeps_what_a_recipe_claims():
    assert suitable_laws(find_experiment("linear/ppo")) == ("none",)  # from nothing
    assert suitable_laws(find_experiment("linear/sac")) == ("flow",)  # LQR is the optimum there
    assert "lqr" in suitable_laws(find_experiment("yielding/sac"))
    laws = suitable_laws(find_experiment("laboratory/apg"))
    assert "lqg-dac" in laws and not {"none", "flow", "lqr", "preview-lqr"} & set(laws)
    assert "gru_hidden_size" in own_values(find_experiment("unknown-specimen/apg"))
    assert "gru_hidden_size" not in own_values(find_experiment("linear/apg"))


def test_ranges_widen_to_what_a_recipe_has():
    wide = replace(TINY, config=replace(SMALL, discount_horizon=30.0))
    knob = next(knob for knob in search_space(wide) if knob.name == "discount_horizon")
    assert knob.high == 30.0 and knob.low == 0.05
    with pytest.raises(ParameterError, match="low must lie below high"):
        Range(name="x", meaning="x [-]", low=0.0, high=1.0)
    assert Choice(name="x", meaning="x", values=(8, 32)).holding(16).values == (8, 16, 32)


def test_its_earthquakes_are_nobody_elses():
    config = trial_config(TINY, {}, 0.5)
    first = config.seed * 100_000
    assert first + 10_000 < EVALUATION_SEED  # lanes begin at consecutive seeds
    seeds = [quake.seed for quake in ValidationSet(TINY, 3).earthquakes]
    assert seeds == [3_000_000, 3_000_001, 3_000_002]
    assert EVALUATION_SEED < 2_000_000 < seeds[0] < seeds[-1] < TEST_SEED
