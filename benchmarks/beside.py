"""``python -m benchmarks.beside TREE``: this code beside that of another working tree, in turns.

Each tree has a process of its own, which runs a case for a spell when it is asked to; medians of CPU
time, and their ratios. The other tree needs the same libraries only.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from pathlib import Path

WORKER = """
import sys, time
import gymnasium, numpy as np
from shake_env import make_scenario
from shake_env.simulation.simulation import Simulation

def batch(name, number, options):
    simulation = Simulation(make_scenario(name, options), number)
    simulation.start(range(number), [np.random.default_rng(i) for i in range(number)])
    still = np.zeros(number)
    return lambda: simulation.step(still)

def single(name):
    env = gymnasium.make("shake_env:ShakeTable-v0", scenario=name)
    env.reset(seed=0)
    still = np.zeros(1, np.float32)
    def call():
        for _ in range(50):
            *_, terminated, truncated, _ = env.step(still)
            if terminated or truncated:
                env.reset()
    return call

def reset(name):
    env = gymnasium.make("shake_env:ShakeTable-v0", scenario=name)
    env.reset(seed=0)
    return lambda: [env.reset() for _ in range(10)]

def stable():
    from agents.learning.vec_env import ShakeTableVecEnv
    env = ShakeTableVecEnv(make_scenario("linear", {"stories": 5}), 64)
    env.seed(0)
    env.reset()
    still = np.zeros((64, 1), np.float32)
    return lambda: env.step(still)

MAKE = {
    "linear, 64": lambda: batch("linear", 64, {"stories": 5}),
    "linear, 1024": lambda: batch("linear", 1024, {"stories": 5}),
    "laboratory, 64": lambda: batch("laboratory", 64, {}),
    "laboratory, 1024": lambda: batch("laboratory", 1024, {}),
    "yielding, 1024": lambda: batch("yielding", 1024, {}),
    "records, 1024": lambda: batch("records", 1024, {}),
    "unknown-specimen, 1024": lambda: batch("unknown-specimen", 1024, {}),
    "linear, one": lambda: single("linear"),
    "laboratory, one": lambda: single("laboratory"),
    "linear, reset": lambda: reset("linear"),
    "laboratory, reset": lambda: reset("laboratory"),
    "unknown-specimen, reset": lambda: reset("unknown-specimen"),
    "SB3, 64": stable,
}
made = {}
print(*MAKE, sep="|", flush=True)
for line in sys.stdin:
    name, spell = line.strip().split("|")
    call = made.setdefault(name, None) or MAKE[name]()
    made[name] = call
    count, begin = 0, time.process_time()
    while count == 0 or time.process_time() - begin < float(spell):
        call()
        count += 1
    print((time.process_time() - begin) / count, flush=True)
"""


class Tree:
    """A process that measures the code of a working tree."""

    def __init__(self, folder: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(
            [sys.executable, "-c", WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
            env=environment, cwd=folder,
        )  # fmt: skip
        self.cases = self._answer().split("|")

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def seconds(self, case: str, spell: float) -> float:
        """Return the CPU seconds of a call."""
        assert self._process.stdin is not None
        print(f"{case}|{spell}", file=self._process.stdin, flush=True)
        return float(self._answer())


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tree", type=Path, help="working tree of the other code")
    parser.add_argument("--spell", type=float, default=0.1, help="CPU seconds of a turn")
    parser.add_argument("--spells", type=int, default=9)
    asked = parser.parse_args()
    ours, theirs = Tree(Path(__file__).parents[1]), Tree(asked.tree.resolve())
    for case in ours.cases:
        for tree in (ours, theirs):
            tree.seconds(case, 0.0)
        pairs = [
            [tree.seconds(case, asked.spell) for tree in (ours, theirs)] for _ in range(asked.spells)
        ]
        mine, other = (statistics.median(column) for column in zip(*pairs, strict=True))
        print(f"{case:26} {mine * 1e6:10.2f} us {other * 1e6:10.2f} us  {other / mine:6.2f}", flush=True)


if __name__ == "__main__":
    main()
