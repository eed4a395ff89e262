"""A policy averaged with its mirror image."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from agents.policies.policy_file import PolicyFile, load_policy
from agents.policies.registry import shipped_policy
from agents.policies.symmetry import mirror_averaged
from agents.training.algorithm_options import APGOptions, PPOOptions
from agents.training.checkpoint import load_checkpoint
from agents.training.config import TrainConfig
from agents.training.run import train, training_tables
from shake_env.errors import ParameterError, PolicyFileError


def made(activation="relu", output="clip", direct=False, widths=(6, 5), inputs=4, features=7, seed=0):
    rng = np.random.default_rng(seed)

    def normal(*shape):
        return rng.normal(0.0, 0.3, shape).astype(np.float32)

    sizes = [features, *widths]
    read = [*sizes[:-1], sizes[-1] + (features if direct else 0)]
    weights = [normal(b, a) for a, b in zip(read, [*widths, 1], strict=True)]
    return PolicyFile(
        matrix=normal(features, inputs), feature_clip=1.0, weights=tuple(weights),
        biases=tuple(normal(len(w)) for w in weights), activation=activation, output=output,
        base=normal(inputs), authority=0.2, card={}, direct=direct,
    )  # fmt: skip


@pytest.mark.parametrize("widths", [(), (6,), (6, 5), (4, 3, 5)])
@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_its_network_says_half_the_difference(activation, direct, widths):
    policy = replace(made(activation, direct=direct and bool(widths), widths=widths), base=np.zeros(4))
    x = np.random.default_rng(1).normal(0.0, 0.5, (200, 4)).astype(np.float32)
    there, back = policy.predict(x)[0], policy.predict(-x)[0]
    inside = (np.abs(there) < 0.2) & (np.abs(back) < 0.2)  # of the bound on what a network says
    assert inside.mean() > 0.5
    found = mirror_averaged(policy).predict(x)[0]
    # Single precision: sums of some ten terms of order 1.
    np.testing.assert_allclose(found[inside], (0.5 * (there - back))[inside], atol=1e-6)


@pytest.mark.parametrize("output", ["clip", "tanh"])
def test_it_is_odd_with_the_law_that_it_corrects(output):
    averaged = mirror_averaged(made(output=output, seed=3))
    x = np.random.default_rng(2).normal(0.0, 3.0, (200, 4)).astype(np.float32)
    np.testing.assert_allclose(averaged.predict(-x)[0], -averaged.predict(x)[0], atol=1e-6)
    again = mirror_averaged(averaged)  # what is odd stays as it is
    np.testing.assert_allclose(again.predict(x)[0], averaged.predict(x)[0], atol=1e-6)


def test_a_memory_is_refused():
    with pytest.raises(PolicyFileError, match="memory"):
        mirror_averaged(load_policy(shipped_policy("apg", "unknown-specimen")))
    for options in (
        {"algorithm": "recurrent-ppo"},
        {"algorithm": "apg", "apg": APGOptions(gru_hidden_size=4)},
        {"algorithm": "apg", "apg": APGOptions(tcn_channels=4)},
    ):
        with pytest.raises(ParameterError, match="odd_symmetry"):
            TrainConfig(odd_symmetry=True, **options)


def test_a_run_keeps_the_average_and_trains_as_without(tmp_path):
    ppo = PPOOptions(n_envs=4, n_steps=16, batch_size=64, actor_bias=True)
    config = TrainConfig(
        ppo=ppo, total_timesteps=128, evaluations=1, evaluation_earthquakes=2, episode_duration=2.0
    )
    for name, mirrored in (("plain", False), ("mirrored", True)):
        train(replace(config, odd_symmetry=mirrored), tmp_path / name)
    tables = training_tables(config, config.scenario.build())
    plain, mirrored = (
        load_checkpoint(tmp_path / name, config, tables) for name in ("plain", "mirrored")
    )
    for one, other in zip(plain.policy.parameters(), mirrored.policy.parameters(), strict=True):
        assert torch.equal(one, other)
    kept = load_policy(tmp_path / "mirrored" / "policy.safetensors")
    assert [len(layer) for layer in kept.weights] == [128, 128, 1]
    x = np.random.default_rng(0).normal(0.0, 1.0, (50, kept.observation_size)).astype(np.float32)
    np.testing.assert_allclose(kept.predict(-x)[0], -kept.predict(x)[0], atol=1e-6)
    of_plain = load_policy(tmp_path / "plain" / "policy.safetensors")
    assert np.abs(of_plain.predict(-x)[0] + of_plain.predict(x)[0]).max() > 1e-3
