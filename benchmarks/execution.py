"""The engines that carry out units of work: overhead, efficiency, the same results by each.

    python benchmarks/execution.py overhead local ray submitit
    python benchmarks/execution.py campaign local ray submitit
    python benchmarks/execution.py efficiency local

``overhead``: 1000 units of 10 ms on two workers. ``campaign``: four small configurations of three seeds
each by every engine; their result files must be equal byte for byte but for times and paths.
``efficiency``: eight paired PPO runs in the laboratory, of the catalogue's settings but short, by one
worker and by two; and what a run's folder holds.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import importlib.metadata
import json
import os
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from agents.execution.options import ExecutionOptions
from agents.execution.units import Unit, UnitRunner
from shake_env.files import write_json

UNITS, SECONDS, WORKERS = 1000, 0.01, 2
TIMES = ("seconds", "run", "code")  # what differs between two runs of one configuration


def versions() -> dict[str, str]:
    """Versions of the engines that are installed."""
    present = {}
    for name in ("ray", "submitit"):
        with contextlib.suppress(importlib.metadata.PackageNotFoundError):
            present[name] = importlib.metadata.version(name)
    return present


def options(engine: str, folder: Path, workers: int = WORKERS) -> ExecutionOptions:
    slurm = ("timeout_min=60",) if engine == "submitit" else ()
    return ExecutionOptions(executor=engine, processes=workers, units=folder, slurm=slurm)  # type: ignore[arg-type]


def overhead(engine: str) -> dict[str, Any]:
    """Wall time of the units, the start of the engine apart, over what the workers sleep."""
    with tempfile.TemporaryDirectory() as name:
        began = time.perf_counter()
        with options(engine, Path(name)).open_executor() as executor:
            runner = UnitRunner(executor)
            # One a worker starts the processes; of Slurm every job starts one.
            runner.run([Unit("warm", time.sleep, (0.5 + 1e-9 * i,)) for i in range(WORKERS)])
            ready = time.perf_counter()
            runner.run([Unit("unit", time.sleep, (SECONDS + 1e-9 * i,)) for i in range(UNITS)])
            done = time.perf_counter()
    ideal = UNITS * SECONDS / WORKERS
    return {
        "engine": engine,
        "start_s": round(ready - began, 2),
        "wall_s": round(done - ready, 2),
        "ideal_s": ideal,
        "overhead_ms_a_unit": round(1e3 * WORKERS * (done - ready - ideal) / UNITS, 2),
    }


def campaign_tasks(folder: Path) -> list[Any]:
    from agents.experiments.recipes import ExperimentConfig
    from agents.experiments.runner import plan_runs
    from agents.training.algorithm_options import APGOptions, PPOOptions, SACOptions
    from agents.training.config import TrainConfig

    small = TrainConfig(
        ppo=PPOOptions(n_envs=4, n_steps=16, batch_size=64, n_epochs=1),
        sac=SACOptions(learning_starts=100, buffer_size=2_000),
        apg=APGOptions(n_envs=4, rollout_horizon=16),
        net_arch=(8,),
        episode_duration=0.2,
        total_timesteps=2_048,
        evaluations=1,
        evaluation_earthquakes=1,
    )
    configs = {
        "ppo": small,
        "ppo-wide": replace(small, net_arch=(16,)),
        "sac": replace(small, algorithm="sac", total_timesteps=512),
        "apg": replace(small, algorithm="apg"),
    }
    experiments = [
        ExperimentConfig(evaluation_task="linear", label=label, config=config, minutes=0.1, seeds=3)
        for label, config in configs.items()
    ]
    return plan_runs(experiments, folder)


def digests(folder: Path) -> dict[str, str]:
    """Digest of every run's policy (weights and card) and evaluations, times and paths left out."""
    from agents.policies.policy_file import load_policy

    digest_of = {}
    for file in sorted(folder.glob("*/*/*/policy.safetensors")):
        policy = load_policy(file)
        parts = [array.tobytes() for array in (*policy.weights, *policy.biases)]
        parts.append(json.dumps(without_times(policy.card), sort_keys=True).encode())
        rows = (file.parent / "evaluations.jsonl").read_text(encoding="utf-8").splitlines()
        parts.append(json.dumps([without_times(json.loads(row)) for row in rows]).encode())
        digest_of[str(file.parent.relative_to(folder))] = hashlib.sha256(b"".join(parts)).hexdigest()[
            :16
        ]
    return digest_of


def without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: without_times(each) for key, each in value.items() if key not in TIMES}
    return [without_times(each) for each in value] if isinstance(value, list) else value


def campaign(engine: str) -> dict[str, Any]:
    """Wall time of a small campaign, and the digest of each of its results."""
    from agents.experiments.runner import Campaign

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "campaign"
        tasks = campaign_tasks(folder)
        began = time.perf_counter()
        with options(engine, Path(name)).open_executor() as executor:
            Campaign(tasks).run(executor)
        assert all(task.state == "done" for task in tasks), [task.failure for task in tasks]
        return {"engine": engine, "wall_s": time.perf_counter() - began, "digests": digests(folder)}


def children_seconds() -> float:
    """Processor time of the processes that this one started and that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def efficiency(engine: str) -> dict[str, Any]:
    """Processor time of a campaign over what two workers take of two cores; the size of a run's folder.

    The work is the processor time with one worker. Its wall time is less: the next run's process starts
    on the other core while a run ends.
    """
    from agents.experiments.catalogue import EXPERIMENTS
    from agents.experiments.runner import Campaign, plan_runs

    (real,) = (each for each in EXPERIMENTS if each.name == "laboratory/ppo")
    batch = real.config.ppo.n_steps * real.config.ppo.n_envs
    short = replace(real.config, total_timesteps=4 * batch, evaluations=2)
    walls, processor, sizes = [], [], {}
    with tempfile.TemporaryDirectory() as name:
        for workers in (1, 2):
            folder = Path(name) / f"campaign-{workers}"
            tasks = plan_runs([replace(real, config=short, seeds=8)], folder)
            began, before = time.perf_counter(), children_seconds()
            with options(engine, Path(name), workers).open_executor() as executor:
                Campaign(tasks).run(executor)
            walls.append(time.perf_counter() - began)
            processor.append(children_seconds() - before)
            assert all(task.state == "done" for task in tasks), [task.failure for task in tasks]
        run = next(folder.glob("*/*/0"))
        for file in sorted(run.rglob("*")):
            if file.is_file():
                sizes[str(file.relative_to(run))] = file.stat().st_size
    return {
        "engine": engine,
        "one_worker_s": round(walls[0], 1),
        "two_workers_s": round(walls[1], 1),
        "processor_s": [round(each, 1) for each in processor],
        "efficiency": round(processor[0] / (2.0 * walls[1]), 3),
        "run_bytes": sizes,
    }


MEASURES = {"overhead": overhead, "campaign": campaign, "efficiency": efficiency}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=sorted(MEASURES))
    parser.add_argument("engines", nargs="+", choices=["local", "ray", "submitit"])
    parser.add_argument("--output", type=Path, help="JSON file that the figures are added to")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    for engine in arguments.engines:
        rows.append(MEASURES[arguments.what](engine))
        print(json.dumps(rows[-1]), flush=True)
    if arguments.output is not None:
        file = arguments.output
        content = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        write_json(
            file, content | {arguments.what: rows, "cores": os.cpu_count(), "versions": versions()}
        )
    if arguments.what == "campaign":
        assert all(row["digests"] == rows[0]["digests"] for row in rows), "the engines differ"
        assert len(rows[0]["digests"]) == 12
        print("12 results, equal by every engine")


if __name__ == "__main__":
    main()
