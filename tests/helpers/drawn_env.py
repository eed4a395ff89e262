"""An environment that draws, run by LQR."""

import numpy as np

from baselines.registry import make_baseline
from shake_env import ShakeTableEnv


def run(steps, seed=3, controller=None, frame_rate=30.0, **overrides):
    env = ShakeTableEnv(render_mode="rgb_array", frame_rate=frame_rate, **overrides)
    controller = controller or make_baseline("lqr", env.scenario)
    observation, _ = env.reset(seed=seed)
    frames, memory = [env.render()], None
    for t in range(steps):
        action, memory = controller.predict(observation, memory, np.array([t == 0]))
        observation, _, terminated, truncated, _ = env.step(action)
        frames.append(env.render())
        if terminated or truncated:
            break
    return env, frames
