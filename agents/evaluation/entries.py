"""The rows of an evaluation: classical controllers, and the policies of some training seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from agents.policies.own_controller import is_own_controller, own_baseline
from agents.policies.policy_file import PolicyFile, file_digest, load_policy
from agents.policies.registry import find_controller, policy_path
from agents.run_directory import BEST, POLICY, policy_of_run
from shake_env.errors import PolicyFileError
from shake_env.scenario.digest import known_name
from shake_env.scenario.scenario import Scenario


@dataclass(frozen=True)
class Entry:
    """A row of a result: a classical controller, or the policies of some training seeds."""

    name: str
    policies: tuple[PolicyFile, ...] = ()  # one a seed; none: a classical controller of that name
    sources: tuple[dict[str, Any], ...] = ()  # likewise: how each was made

    @property
    def runs(self) -> int:
        """Number of rows that its table of episodes has."""
        return max(1, len(self.policies))


def find_entry(text: str, scenario: Scenario) -> Entry:
    """Return what a word of the command line stands for.

    Parameters
    ----------
    text
        A classical controller's name, ``oracle``, ``ppo`` or ``apg`` (those that ship),
        ``module:Class`` or ``file.py:Class`` (`agents.policies.own_controller`), or ``PATH`` or
        ``NAME=PATH,PATH...``: policy files, run directories and folders of run directories,
        whose policies together are one row.
    scenario
        What a policy has to fit.

    Raises
    ------
    ScenarioError
        If it is none of these.
    PolicyFileError
        If a policy cannot be read or does not fit the scenario, or a folder holds none.
    """
    name, separator, paths = text.rpartition("=")
    if not separator or is_own_controller(text):
        entry = find_controller(text)
        if entry.kind == "own":
            own_baseline(text)  # says at once if there is no such class
        if entry.kind == "shipped":
            return _learned(entry.name, [policy_path(entry.name, known_name(scenario))], scenario)
        if entry.kind != "file":
            return Entry(entry.name)
    files = [file for path in paths.split(",") for file in policy_files(Path(path))]
    return _learned(name or Path(paths.split(",")[0]).stem, files, scenario)


def policy_files(path: str | PathLike[str]) -> list[Path]:
    """Return the policy files that a path stands for: itself, its run's, or those of the runs in it.

    Of an interrupted run that is named itself its best policy so far; of a folder of runs those of the
    finished ones.

    Raises
    ------
    PolicyFileError
        If there are none.
    """
    path = Path(path)
    if not path.is_dir():
        return [path]
    if (own := policy_of_run(path)).exists():
        return [own]
    # Seed 10 comes after seed 9.
    files = sorted(path.glob(f"*/{POLICY}"), key=lambda f: (len(f.parent.name), f.parent.name))
    if not files:
        raise PolicyFileError(
            "entry", str(path), f"holds no {POLICY} or {BEST}, and no runs with a {POLICY}"
        )
    return files


def _learned(name: str, files: Sequence[Path], scenario: Scenario) -> Entry:
    policies, sources = [], []
    for file in files:
        policy = load_policy(file).reading(scenario)
        config = policy.card.get("config", {})
        policies.append(policy)
        sources.append(
            {
                "seed": config.get("seed"),
                "algorithm": config.get("algorithm"),
                "scenario": config.get("scenario", {}).get("scenario"),
                "command": policy.card.get("command"),
                "version": policy.card.get("version"),
                "code": policy.card.get("code"),
                "sha256": file_digest(file),
            }
        )
    return Entry(name, tuple(policies), tuple(sources))
