"""LQR against PPO on one linear table: what learning reaches where the optimum is known.

python examples/lqr_against_ppo.py                  # about two minutes; PPO ends near LQR
python examples/lqr_against_ppo.py --steps 20000    # seconds; PPO is still poor
"""

import argparse
import tempfile
from pathlib import Path

from agents.policies import load_policy
from agents.training import TrainConfig, train
from baselines.lqr import lqr, sampled_lqr
from shake_env import NoControl, make_scenario
from shake_env.rollout import noise_earthquakes, rollout

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--steps", type=int, default=1_500_000, help="control periods to learn from")
steps = parser.parse_args().steps

with tempfile.TemporaryDirectory() as folder:
    run = Path(folder) / "run"
    train(TrainConfig(total_timesteps=steps), run)
    policy = load_policy(run / "policy.safetensors")

scenario = make_scenario("linear")
# Earthquakes that neither training (seeds below a million) nor its evaluation has seen.
earthquakes = noise_earthquakes(scenario, 16, seed=2_000_000)
print(f"analytic cost of LQR: {sampled_lqr(scenario.discrete, scenario.stage_cost).analytic_cost:.4f}")
for name, controller in {"LQR": lqr(scenario), "PPO": policy, "no control": NoControl()}.items():
    rows, _ = rollout(controller, scenario, earthquakes)
    cost = sum(row.cost for row in rows) / len(rows)
    shear = sum(row.base_shear_rms_error for row in rows) / len(rows)
    print(f"{name:10s}  mean stage cost {cost:7.4f}, base-shear error {100 * shear:5.1f} %")
