"""PPO in one file over a batch of tables, in the manner of CleanRL: no framework, every line in sight.

    python examples/cleanrl_ppo.py
    python examples/cleanrl_ppo.py --steps 4096 --tables 8    # seconds

Clipped surrogate and generalised advantages after Schulman et al. (2015, 2017). The batch is Gymnasium's
vector environment. An episode's truncation is no end of the task: the value of its last observation is
added to the reward before the advantages are summed.
"""

import argparse
import math
import time

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--steps", type=int, default=2_000_000, help="control periods to learn from")
parser.add_argument("--tables", type=int, default=64, help="tables side by side")
parser.add_argument("--seed", type=int, default=0)
args = parser.parse_args()

HORIZON, EPOCHS, BATCHES = 128, 10, 4
GAMMA, LAMBDA, CLIP, RATE = math.exp(-0.005 / 0.25), 0.9, 0.2, 3e-4  # looks 0.25 s ahead at 200 Hz
torch.manual_seed(args.seed)
torch.set_num_threads(1)  # the matrices are small

envs = gymnasium.make_vec(
    "shake_env:ShakeTable-v0",
    num_envs=args.tables,
    vectorization_mode="vector_entry_point",
    autoreset_mode=AutoresetMode.SAME_STEP,
    duration=10.0,
    # A hopeless table ends early and pays for it, so that a first policy learns where learning is.
    fields={"limits.state_limit": 12.0, "limits.cost_horizon": 0.25},
)
scenario = envs.unwrapped.scenario
size = scenario.observation.size
# The position of a linear table feeds nothing and wanders; a network should not see it.
seen = [i for i in range(size) if i != scenario.plant.layout.table_displacement]


def network(last: float) -> nn.Sequential:
    """Two hidden layers; the gain of the last one decides how far from zero it begins."""
    layers = [nn.Linear(len(seen), 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, 1)]
    for layer, gain in zip(layers[::2], (math.sqrt(2), math.sqrt(2), last), strict=True):
        nn.init.orthogonal_(layer.weight, gain)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(*layers)


actor, critic = network(0.01), network(1.0)
log_std = nn.Parameter(torch.tensor([-3.0]))  # exploration: 5 % of full current
parameters = [*actor.parameters(), *critic.parameters(), log_std]
optimiser = torch.optim.Adam(parameters, lr=RATE, eps=1e-5)


def tensor(array: np.ndarray) -> torch.Tensor:
    """Return what a network sees of observations (..., n), bounded."""
    return torch.as_tensor(np.clip(array[..., seen], -10.0, 10.0), dtype=torch.float32)


observation, _ = envs.reset(seed=args.seed * 100_000)
updates = max(args.steps // (HORIZON * args.tables), 1)
started = time.time()
for update in range(updates):
    optimiser.param_groups[0]["lr"] = RATE * (1.0 - update / updates)
    kept = {name: [] for name in ("x", "action", "log_probability", "reward", "done", "value", "cost")}
    for _ in range(HORIZON):
        x = tensor(observation)
        with torch.no_grad():
            policy = torch.distributions.Normal(actor(x), log_std.exp())
            action = policy.sample()
            value = critic(x)[:, 0]
        observation, reward, terminated, truncated, info = envs.step(action.numpy())
        kept["cost"].append(-reward.mean())
        reward = (1.0 - GAMMA) * reward  # values are then of the size of one stage cost
        if truncated.any():
            last = np.stack(info["final_obs"][truncated])
            with torch.no_grad():
                reward[truncated] += GAMMA * critic(tensor(last))[:, 0].numpy()
        row = (
            x, action, policy.log_prob(action)[:, 0], torch.as_tensor(reward, dtype=torch.float32),
            torch.as_tensor(terminated | truncated, dtype=torch.float32), value,
        )  # fmt: skip
        for name, entry in zip(kept, row, strict=False):
            kept[name].append(entry)
    data = {name: torch.stack(rows) for name, rows in kept.items() if name != "cost"}
    with torch.no_grad():
        following, advantage = critic(tensor(observation))[:, 0], torch.zeros(args.tables)
        advantages = torch.zeros_like(data["reward"])
        for t in reversed(range(HORIZON)):
            goes_on = 1.0 - data["done"][t]
            error = data["reward"][t] + GAMMA * goes_on * following - data["value"][t]
            advantage = error + GAMMA * LAMBDA * goes_on * advantage
            advantages[t], following = advantage, data["value"][t]
    data["advantage"], data["target"] = advantages, advantages + data["value"]
    flat = {name: part.flatten(0, 1) for name, part in data.items()}
    for _ in range(EPOCHS):
        for picked in torch.randperm(HORIZON * args.tables).chunk(BATCHES):
            batch = {name: part[picked] for name, part in flat.items()}
            policy = torch.distributions.Normal(actor(batch["x"]), log_std.exp())
            ratio = (policy.log_prob(batch["action"])[:, 0] - batch["log_probability"]).exp()
            gain = batch["advantage"]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            surrogate = torch.min(ratio * gain, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gain).mean()
            loss = 0.5 * (critic(batch["x"])[:, 0] - batch["target"]).square().mean() - surrogate
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(parameters, 0.5)
            optimiser.step()
    if update % 20 == 0 or update == updates - 1:
        done = (update + 1) * HORIZON * args.tables
        cost, rate = np.mean(kept["cost"]), done / (time.time() - started)
        print(
            f"{done:8d} steps, mean stage cost {cost:.3f} with exploration, {rate:.0f} steps/s",
            flush=True,
        )
