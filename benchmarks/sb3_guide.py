"""``python -m benchmarks.sb3_guide --json docs/results/sb3_guide.json``: figures of the SB3 guide.

The guide's script with one of its settings changed at a time, and its SAC. Runs that the file holds
are not run again. ``python docs/generate.py`` then writes the table of docs/howto/train_with_sb3.md.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC

from agents.learning.sb3_env import SB3Controller, VecTrackingFeatures
from agents.learning.training_scenario import (
    GAMMA,
    STATE_LIMIT,
    horizon_of,
    make_training_scenario,
    reward_scale,
)
from agents.learning.vec_env import ShakeTableVecEnv
from agents.seeds import COMPARISON_SEED
from baselines.lqr import lqr
from shake_env import make_scenario
from shake_env.files import write_text
from shake_env.rollout import noise_earthquakes, rollout
from shake_env.scenario.limits import OBSERVATION_BOUND

STEPS = {"PPO": 1_048_576, "SAC": 60_000}
# What is changed of the script, in words, and the settings that do it.
VARIANTS: dict[str, dict[str, Any]] = {
    "the script": {},
    "action scale 0.25 instead of 1.0": {"action_scale": 0.25},
    "initial log standard deviation 0 instead of -2.5": {"log_std": 0.0},
    "states instead of features": {"features": False},
    "unscaled rewards": {"scaled": False},
    "no early end of an episode": {"state_limit": OBSERVATION_BOUND},
    "SAC, as below": {"algorithm": "SAC", "action_scale": 0.4},
}


class OnStates:
    """A model that was trained on the bare environment's observations, as its controller."""

    def __init__(self, model: PPO, action_scale: float) -> None:
        self.model, self.action_scale = model, action_scale

    def predict(self, observation: Any, *_: Any, **__: Any) -> tuple[Any, None]:
        """Return actions (..., 1) for observations (..., n)."""
        action, _ = self.model.predict(observation, deterministic=True)
        return self.action_scale * action, None


def train(
    seed: int,
    steps: int,
    *,
    algorithm: str = "PPO",
    action_scale: float = 1.0,
    log_std: float = -2.5,
    features: bool = True,
    scaled: bool = True,
    state_limit: float = STATE_LIMIT,
) -> dict[str, Any]:
    """Train the guide's model; return its cost over LQR's and what it took."""
    scenario = make_scenario("linear")
    training = make_training_scenario(
        scenario, horizon=horizon_of(GAMMA, scenario.control_period), state_limit=state_limit
    )
    tables = ShakeTableVecEnv(
        training,
        64,
        authority=action_scale,
        reward_scale=reward_scale(training, GAMMA) if scaled else 1.0,
    )
    env = VecTrackingFeatures(tables, training) if features else tables
    if algorithm == "PPO":
        model = PPO(
            "MlpPolicy", env, n_steps=128, batch_size=2048, learning_rate=lambda left: 3e-4 * left,
            gamma=GAMMA, policy_kwargs={"log_std_init": log_std}, seed=seed, device="cpu",
        )  # fmt: skip
    else:
        model = SAC(
            "MlpPolicy", env, gradient_steps=16, learning_starts=5_000, gamma=GAMMA,
            learning_rate=lambda left: 1e-3 * left, ent_coef="auto_0.001", target_entropy=-2.0,
            seed=seed, device="cpu",
        )  # fmt: skip
    began = time.process_time()
    model.learn(steps)
    seconds = time.process_time() - began
    controller = (
        SB3Controller(model, scenario, action_scale=action_scale)
        if features
        else OnStates(model, action_scale)
    )
    quakes = noise_earthquakes(scenario, 32, COMPARISON_SEED)
    cost, reference = (
        float(np.mean([row.cost for row in rollout(each, scenario, quakes)[0]]))
        for each in (controller, lqr(scenario))
    )
    return {"steps": model.num_timesteps, "ratio": cost / reference, "seconds": seconds}


def main() -> None:
    """Run what the file lacks, and write it after each run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path, required=True, help="file of the results")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1])
    parser.add_argument("--steps", type=int, help="fewer for a look; default: those of the guide")
    parser.add_argument("--only", nargs="+", choices=list(VARIANTS), default=list(VARIANTS))
    given = parser.parse_args()
    torch.set_num_threads(1)
    results = json.loads(given.json.read_text(encoding="utf-8")) if given.json.exists() else []
    known = {(row["variant"], row["seed"]) for row in results}
    for seed in given.seeds:
        for variant in given.only:
            if (variant, seed) in known:
                continue
            options = VARIANTS[variant]
            steps = given.steps or STEPS[options.get("algorithm", "PPO")]
            results.append({"variant": variant, "seed": seed, **train(seed, steps, **options)})
            print(results[-1], flush=True)
            lines = ",\n ".join(json.dumps(row) for row in results)
            write_text(given.json, f"[\n {lines}\n]\n")


if __name__ == "__main__":
    main()
