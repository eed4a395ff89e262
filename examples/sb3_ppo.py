"""Stable-Baselines3's own PPO on the linear table, beside LQR on the same earthquakes.

python examples/sb3_ppo.py --steps 4000000    # about four minutes of one core
python examples/sb3_ppo.py --steps 8192       # seconds; the policy is still poor
"""

import argparse
import time

import torch
from stable_baselines3 import PPO

from agents.learning import compare_with_reference, make_sb3_env

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument(
    "--steps", type=int, default=4_000_000, help="control periods of all tables together"
)
parser.add_argument("--seed", type=int, default=0, help="seed of networks, exploration and earthquakes")
arguments = parser.parse_args()

torch.set_num_threads(1)  # fastest for networks of this size
action_scale, gamma = 1.0, 0.98  # action 1 is 125 mA; the discount looks 0.25 s ahead
env = make_sb3_env("linear", num_envs=64, action_scale=action_scale, gamma=gamma)
model = PPO(
    "MlpPolicy",
    env,
    n_steps=128,
    batch_size=2048,
    learning_rate=lambda left: 3e-4 * left,  # falls to zero
    gamma=gamma,
    policy_kwargs={"log_std_init": -2.5},  # exploration of 10 mA instead of SB3's 125 mA
    seed=arguments.seed,
    device="cpu",
)
wall, processor = time.perf_counter(), time.process_time()
model.learn(arguments.steps)
wall, processor = time.perf_counter() - wall, time.process_time() - processor
print(compare_with_reference(model, "linear", action_scale=action_scale))
print(f"{model.num_timesteps} steps, {wall:.0f} s, {processor:.0f} s of the processor")
