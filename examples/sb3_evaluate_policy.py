"""SB3's own `evaluate_policy` over LQR, the policy that ships and a model of SB3: one signature for all.

python examples/sb3_evaluate_policy.py
python examples/sb3_evaluate_policy.py --steps 512 --duration 1    # seconds
"""

import argparse

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

from agents.policies import load_policy, shipped_policy
from baselines.lqr import lqr
from shake_env import NoControl, make_scenario

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--steps", type=int, default=50_000, help="control periods that PPO learns from")
parser.add_argument("--duration", type=float, default=10.0, help="length of an earthquake [s]")
arguments = parser.parse_args()

options = {"duration": arguments.duration}
scenario = make_scenario("linear", {"duration": arguments.duration})
train_env = make_vec_env("shake_env:ShakeTable-v0", n_envs=4, seed=0, env_kwargs=options)
# Exploration is noise on the valve: begin with 5 % of full current rather than SB3's 100 %.
model = PPO("MlpPolicy", train_env, n_steps=128, policy_kwargs={"log_std_init": -3.0}, seed=0)
model.learn(arguments.steps)

candidates = {
    "LQR": lqr(scenario),
    "policy that ships": load_policy(shipped_policy()),
    f"PPO, {model.num_timesteps} steps": model,
    "no control": NoControl(),
}
for name, candidate in candidates.items():
    # A new environment of the same seed each time: everyone meets the same earthquakes.
    test_env = make_vec_env("shake_env:ShakeTable-v0", n_envs=4, seed=2_000_000, env_kwargs=options)
    mean, spread = evaluate_policy(candidate, test_env, n_eval_episodes=8)
    periods = scenario.control_rate * arguments.duration
    print(f"{name:20s} mean stage cost {-mean / periods:8.3f} +- {spread / periods:.3f}")
