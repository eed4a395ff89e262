"""Training that begins with a policy file: by another algorithm, and with what does not fit refused."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import BaseCallback

from agents.policies.policy_file import file_digest, load_policy
from agents.policies.registry import policy_path
from agents.policies.symmetry import mirror_averaged
from agents.run_directory import FIRST, learning_curve
from agents.scenario_options import ScenarioOptions
from agents.training.algorithm_options import (
    APGOptions,
    PPOOptions,
    RecurrentPPOOptions,
    SACOptions,
    TD3Options,
    TQCOptions,
)
from agents.training.checkpoint import load_checkpoint
from agents.training.config import TrainConfig, config_of
from agents.training.model_factory import new_model
from agents.training.policy_export import export_policy
from agents.training.run import resume, train, training_tables
from agents.training.warm_start import load_actor_weights
from shake_env.errors import PolicyFileError

FRICTION = ScenarioOptions(set=("nonlinearity.friction.coulomb=300",))
FREE = APGOptions(
    n_envs=2, base_controller="lqg-searched", residual_scale=0.1, gru_hidden_size=64, actor_bias=True
)


def model_of(config, direct=False):
    env = training_tables(config, config.scenario.build())
    return new_model(config, env.scenario, env, direct=direct), env


def policy_of(config):
    """A policy as a run would keep it, none of its parameters at zero that training could move."""
    model, env = model_of(config)
    generator = np.random.default_rng(3)
    policy = export_policy(model, env, {})
    moved = tuple(w + 0.05 * generator.normal(size=w.shape).astype(np.float32) for w in policy.weights)
    kept = replace(policy, weights=moved)
    return mirror_averaged(kept) if config.odd_symmetry else kept


@pytest.mark.parametrize(
    ("giver", "taker"),
    [
        (TrainConfig(algorithm="apg"), TrainConfig()),
        (TrainConfig(), TrainConfig(algorithm="apg")),
        (TrainConfig(odd_symmetry=True), TrainConfig(net_arch=(128, 128))),
        (TrainConfig(odd_symmetry=True), TrainConfig(algorithm="apg", net_arch=(128, 128))),
        (
            TrainConfig(algorithm="apg", scenario=FRICTION),
            TrainConfig(scenario=FRICTION, ppo=PPOOptions(actor_bias=True)),
        ),
        (TrainConfig(algorithm="sac"), TrainConfig(algorithm="td3", td3=TD3Options(residual_scale=0.5))),
        (TrainConfig(algorithm="td3"), TrainConfig(algorithm="tqc")),
        (
            TrainConfig(algorithm="apg", apg=APGOptions(gru_hidden_size=8), scenario=FRICTION),
            TrainConfig(algorithm="apg", apg=APGOptions(gru_hidden_size=8), scenario=FRICTION),
        ),
        (
            TrainConfig(algorithm="apg", apg=APGOptions(tcn_channels=8), scenario=FRICTION),
            TrainConfig(algorithm="apg", apg=APGOptions(tcn_channels=8), scenario=FRICTION),
        ),
        (
            TrainConfig(algorithm="recurrent-ppo", scenario=FRICTION),
            TrainConfig(algorithm="recurrent-ppo", scenario=FRICTION),
        ),
    ],
    ids=lambda config: f"{config.algorithm}{'-mirrored' * config.odd_symmetry}",
)
def test_a_model_acts_as_the_policy_that_it_begins_with(giver, taker):
    policy = policy_of(giver)
    taker = replace(
        taker,
        **{taker.algorithm.replace("-", "_"): replace(taker.chosen, residual_scale=policy.authority)},
    )
    model, env = model_of(taker, direct=policy.direct)
    load_actor_weights(model, env, policy)
    begun = export_policy(model, env, {})
    seen = np.random.default_rng(0).normal(size=(3, 50, policy.observation_size)).astype(np.float32)
    one = two = None
    for observation in seen:  # one after the other, for the memory's sake
        expected, one = policy.predict(observation, one)
        found, two = begun.predict(observation, two)
        np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.std(expected) > 1e-3


def test_a_correction_behind_an_estimator_goes_on():
    config = TrainConfig(algorithm="apg", scenario=ScenarioOptions("unknown-specimen"), apg=FREE)
    policy = policy_of(config)
    model, env = model_of(config)
    load_actor_weights(model, env, policy)
    begun = export_policy(model, env, {})
    for ours, theirs in zip(begun.weights, policy.weights, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(begun.memory.hidden_weight, policy.memory.hidden_weight)


def test_a_policy_goes_on_with_its_own_law_where_that_was_tuned_anew(tmp_path):
    """A policy file holds its law; the values tuned for the law's name may be others by now."""
    shipped = load_policy(policy_path("ppo", "laboratory"))
    older = replace(shipped.law, show=1.01 * shipped.law.show)
    file = tmp_path / "older.safetensors"
    replace(shipped, law=older).save(file)
    options = config_of(shipped.card["config"]).ppo
    config = TrainConfig(
        scenario=ScenarioOptions("laboratory"), init_policy=str(file), episode_duration=0.3,
        ppo=replace(options, n_envs=4, n_steps=32, batch_size=64), total_timesteps=256, evaluations=1,
        evaluation_earthquakes=1, checkpoint_interval=1e-9,
        net_arch=tuple(len(bias) for bias in shipped.biases[:-1]),
    )  # fmt: skip
    train(config, tmp_path / "run")
    ended = load_policy(tmp_path / "run/policy.safetensors")
    np.testing.assert_allclose(ended.law.show, older.show, rtol=1e-6)
    result = tmp_path / "run/result.json"
    result.unlink()
    resume(tmp_path / "run")  # goes on from its last checkpoint, on the same law
    again = load_policy(tmp_path / "run/policy.safetensors")
    np.testing.assert_array_equal(again.law.show, ended.law.show)
    other = replace(config, ppo=replace(config.ppo, base_controller="lqg"))
    with pytest.raises(PolicyFileError, match="law"):
        train(other, tmp_path / "other")


def tiny(critic_first=0.0, **changes):
    ppo = PPOOptions(
        n_envs=4, n_steps=32, batch_size=64, n_epochs=2, critic_warmup_fraction=critic_first
    )
    return TrainConfig(
        ppo=ppo, apg=APGOptions(n_envs=4, rollout_horizon=16), net_arch=(16,), episode_duration=0.2,
        total_timesteps=512, evaluations=2, evaluation_earthquakes=2, checkpoint_interval=1e-9,
        **changes,
    )  # fmt: skip


def test_a_run_begins_where_its_policy_stands_and_says_so(tmp_path):
    first = train(tiny(algorithm="apg"), tmp_path / "first")
    config = tiny(init_policy=str(tmp_path / "first"), critic_first=0.3)
    train(config, tmp_path / "second")
    begun = dict(learning_curve(str(tmp_path / "second")))[0]
    assert begun == pytest.approx(first.cost_ratio, rel=1e-6)
    card = load_policy(tmp_path / "second" / "policy.safetensors").card
    assert card["first"]["sha256"] == file_digest(tmp_path / "first" / "policy.safetensors")
    assert file_digest(tmp_path / "second" / FIRST) == card["first"]["sha256"]

    def kill(progress):
        if progress.steps >= 256:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config, tmp_path / "cut", report=kill)
    resume(tmp_path / "cut")
    curves = [dict(learning_curve(str(tmp_path / run))) for run in ("second", "cut")]
    assert curves[0] == curves[1]
    assert curves[0][512] != begun  # it did not stand still
    models = [
        load_checkpoint(tmp_path / run, config, training_tables(config, config.scenario.build()))
        for run in ("second", "cut")
    ]
    vectors = [torch.nn.utils.parameters_to_vector(model.policy.parameters()) for model in models]
    assert torch.equal(*vectors)


@pytest.mark.parametrize(
    ("config", "wrong"),
    [
        (TrainConfig(scenario=ScenarioOptions(stories=5)), "features"),
        (TrainConfig(scenario=ScenarioOptions("laboratory")), "features"),
        (TrainConfig(ppo=PPOOptions(base_controller="lqr")), "law"),
        (TrainConfig(ppo=PPOOptions(residual_scale=0.5)), "authority"),
        (TrainConfig(net_arch=(32, 64)), r"layers.*64 64.*--config.net-arch 64 64"),
        (TrainConfig(net_arch=(64,)), "layers"),
        (
            TrainConfig(algorithm="sac", sac=SACOptions(base_controller="none", residual_scale=1.0)),
            "output",
        ),
        (
            TrainConfig(algorithm="tqc", tqc=TQCOptions(base_controller="none", residual_scale=1.0)),
            "output",
        ),
        (
            TrainConfig(
                algorithm="recurrent-ppo",
                recurrent_ppo=RecurrentPPOOptions(base_controller="none", residual_scale=1.0),
            ),
            "memory",
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else value.algorithm,
)
def test_what_does_not_fit_is_refused_and_leaves_nothing_behind(config, wrong):
    given = policy_of(TrainConfig())
    model, env = model_of(config)
    before = export_policy(model, env, {})
    with pytest.raises(PolicyFileError, match=wrong):
        load_actor_weights(model, env, given)
    for ours, theirs in zip(export_policy(model, env, {}).weights, before.weights, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    ("given", "own", "remedy"),
    [
        ({"tcn_channels": 8}, {}, "memory.*tcn, 8 units.*here none: give .*tcn-channels 8"),
        ({"tcn_channels": 8}, {"tcn_channels": 4}, "here tcn, 4 units.*tcn-channels 8"),
        (
            {"tcn_channels": 8},
            {"gru_hidden_size": 8},
            "here gru, 8 units: give .*gru-hidden-size 0 .*tcn-channels 8",
        ),
        ({"actor_bias": True}, {"tcn_channels": 8}, "memory.*none.*give .*tcn-channels 0"),
    ],
    ids=str,
)
def test_another_memory_is_refused_with_the_options_that_make_it(given, own, remedy):
    policy = policy_of(TrainConfig(algorithm="apg", apg=APGOptions(**given)))
    with pytest.raises(PolicyFileError, match=remedy):
        load_actor_weights(*model_of(TrainConfig(algorithm="apg", apg=APGOptions(**own))), policy)


def test_a_direct_path_and_biases_need_their_place():
    direct = policy_of(TrainConfig(algorithm="apg"))
    with pytest.raises(PolicyFileError, match="direct path"):
        load_actor_weights(*model_of(TrainConfig()), direct)
    biased = policy_of(TrainConfig(ppo=PPOOptions(actor_bias=True)))
    biased.biases[0][:] = 0.1
    with pytest.raises(PolicyFileError, match=r"biases.*actor-bias"):
        load_actor_weights(*model_of(TrainConfig()), biased)


def test_a_run_that_cannot_begin_makes_no_directory(tmp_path):
    config = TrainConfig(init_policy=str(tmp_path / "nothing.safetensors"))
    with pytest.raises(PolicyFileError, match="no such file"):
        train(config, tmp_path / "run")
    assert not (tmp_path / "run").exists()


class Copies(BaseCallback):
    """Copies of a policy's parameters, by name, before each roll-out."""

    def __init__(self):
        super().__init__()
        self.taken = []

    def _on_rollout_start(self):
        parameters = self.model.policy.named_parameters()
        self.taken.append({name: p.detach().numpy().copy() for name, p in parameters})

    def _on_step(self):
        return True


@pytest.mark.parametrize("scale_free", [True, False])
def test_the_critic_learns_first(scale_free):
    config = tiny(critic_first=0.5)
    config = replace(config, ppo=replace(config.ppo, actor_bias=not scale_free))
    model, _ = model_of(config)
    copies = Copies()
    model.learn(512, callback=copies)  # four roll-outs of 128
    begun, early, later, _ = copies.taken
    still = {"log_std", *(name for name in begun if "policy_net" in name or "action_net" in name)}
    assert {name for name in begun if np.array_equal(begun[name], early[name])} == still
    biases = {name for name in still if "bias" in name}
    unmoved = {name for name in begun if np.array_equal(begun[name], later[name])}
    assert unmoved == (biases if scale_free else set())
