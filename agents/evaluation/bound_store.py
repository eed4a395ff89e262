"""True bounds of earthquakes, each computed once: what was found is kept in the user's cache.

A bound depends on the plant, its objective and limits, the target and the reference's base shear, and on
the code that searches it. All of these make its key; the sensors and the preview do not change it. The
folder is ``bounds`` in `cache_folder`; it can be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from agents.run_directory import cache_folder
from baselines.planning.bound import (
    THREADS,
    OptimalEpisode,
    Start,
    optimal_episodes,
    starting_laws,
)
from baselines.planning.episodes import Episode, driven, episodes
from shake_env.errors import FileError, ScenarioError, ShakeError
from shake_env.files import write_json
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import FilteredNoise
from shake_env.rollout import Earthquake
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.observation import Sensing
from shake_env.scenario.scenario import Scenario

BATCH = 32  # earthquakes whose trajectories are in memory at a time
SOLVER_TOLERANCE = 1e-4  # [-] of the cost, what the search may leave beside what its starts differ by
AGREEMENT = 0.01  # [-] of the cost, what the starts may differ by where a bound is established
# Shares of the first law's currents to start from where fewer than two starts keep the limits; the
# last one is the uncontrolled table.
GENTLER = (0.5, 0.2, 0.0)
MOST_NAMED = 5  # earthquakes in a message
REMEDY = "take a smaller amplitude; what keeps the limits there can be compared without a bound"
# What a bound depends on besides the episode: the code that searches it.
SEARCH_CODE = {
    "baselines.planning": ("bound.py", "ilqr_kernel.py", "model.py", "period_kernel.py"),
    "shake_env.kernels": ("lanes.py", "table_adjoint.py"),
}


@dataclass(frozen=True)
class EpisodeBound:
    """The least cost of one earthquake over all currents, everything known."""

    cost: float  # mean stage cost; infinite if no start led to one that keeps the limits
    starts: tuple[Start, ...]

    @property
    def disagreement(self) -> float:
        """Cost of the worst start over that of the best one, minus 1 [-]."""
        costs = [start.cost for start in self.starts if start.feasible]
        return max(costs) / min(costs) - 1.0 if costs else math.inf

    @property
    def seconds(self) -> float:
        """Processor time [s] of the whole search: the sum over its starts."""
        return sum(start.seconds for start in self.starts)


@dataclass(frozen=True)
class Bounds:
    """The bounds of the first earthquakes of a set; none where there is a reason."""

    episodes: tuple[EpisodeBound, ...] = ()
    reason: str = ""  # why there are none

    @property
    def costs(self) -> FloatArray:
        """Mean stage cost (n,) of each."""
        return np.array([each.cost for each in self.episodes])

    def to_json(self) -> dict[str, Any]:
        """Return costs and how far the starts agreed, as plain JSON values."""
        return {
            "costs": [float(f"{each.cost:.7g}") for each in self.episodes],
            "disagreements": [float(f"{each.disagreement:.3g}") for each in self.episodes],
            "code": search_code(),
            "reason": self.reason,
        }


@lru_cache
def search_code() -> str:
    """Return a digest of the code that bounds are searched with."""
    digest = hashlib.sha256()
    for package, files in SEARCH_CODE.items():
        for file in files:
            digest.update(resources.files(package).joinpath(file).read_bytes())
    return digest.hexdigest()[:16]


def earthquake_bounds(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    *,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Bounds:
    """Return the bound of each earthquake, from the cache where it was computed before.

    Parameters
    ----------
    scenario, earthquakes
        As for a roll-out.
    on_progress
        Told the share done, 0 to 1.

    Returns
    -------
    None, with the reason, where the equations are not the corrected ones or numba is missing.
    """
    bounds: list[EpisodeBound] = []
    for first in range(0, len(earthquakes), BATCH):
        batch = earthquakes[first : first + BATCH]

        def on_share(share: float, first: int = first, number: int = len(batch)) -> None:
            on_progress((first + share * number) / len(earthquakes))

        try:
            bounds += _batch(scenario, batch, on_share)
        except ScenarioError as error:
            return Bounds(reason=error.remedy)
        except ShakeError as error:
            if error.field != "numba":
                raise
            return Bounds(reason=error.remedy)
    on_progress(1.0)
    lost = [quake.name for quake, each in zip(earthquakes, bounds, strict=True) if math.isinf(each.cost)]
    if lost:
        return Bounds(reason=f"no currents that keep the limits were found on {_some(lost)}: {REMEDY}")
    return Bounds(tuple(bounds))


def _batch(
    scenario: Scenario, earthquakes: Sequence[Earthquake], on_share: Callable[[float], None]
) -> list[EpisodeBound]:
    keys = [_key(episode) for episode in episodes(scenario, earthquakes)]
    bound_of = {key: known for key in keys if (known := _read(key)) is not None}
    # Copies of one motion are one.
    missing = [i for i, key in enumerate(keys) if key not in bound_of and keys.index(key) == i]
    if missing:
        optima = best_episodes(scenario, [earthquakes[i] for i in missing], on_share)
        for i, optimum in zip(missing, optima, strict=True):
            bound_of[keys[i]] = _keep(keys[i], optimum)
    return [bound_of[key] for key in keys]


def best_episodes(
    scenario: Scenario,
    earthquakes: Sequence[Earthquake],
    on_step: Callable[[float], None] = lambda share: None,
) -> list[OptimalEpisode]:
    """Return `optimal_episodes`, from `GENTLER` starts as well where fewer than two keep the limits."""
    optima = optimal_episodes(scenario, earthquakes, threads=THREADS, on_step=on_step)
    weak = [i for i, each in enumerate(optima) if _lacks_starts(each.starts)]
    if not weak:
        return optima
    shaken = [earthquakes[i] for i in weak]
    currents = driven(next(iter(starting_laws(scenario).values())), scenario, shaken)[0]
    starts = {_share_name(share): [share * each for each in currents] for share in GENTLER}
    further = optimal_episodes(scenario, shaken, starts=starts, threads=THREADS)
    for i, other in zip(weak, further, strict=True):
        better = min(optima[i], other, key=lambda optimum: optimum.cost)
        optima[i] = replace(better, starts=(*optima[i].starts, *other.starts))
    return optima


def _lacks_starts(starts: Sequence[Start]) -> bool:
    """Return whether fewer than two starts keep the limits, and `GENTLER` ones were not tried yet."""
    tried = any(start.name == _share_name(GENTLER[-1]) for start in starts)
    return not tried and sum(start.feasible for start in starts) < 2


def _share_name(share: float) -> str:
    return f"{share:g} of the first law's currents"


def _some(names: Sequence[str]) -> str:
    more = f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else ""
    return ", ".join(names[:MOST_NAMED]) + more


def _key(episode: Episode) -> str:
    plant = episode.model.scenario
    # The motion is what the samples say, and the sensors change nothing that a current can reach.
    plain = replace(plant, sensing=Sensing(), motion=FilteredNoise())
    digest = hashlib.sha256(f"{search_code()} {scenario_digest(plain)}".encode())
    for signal in (episode.target, episode.shear):
        # Batches of another width round the last bits otherwise.
        digest.update(np.ascontiguousarray(signal, dtype=np.float32).tobytes())
    return digest.hexdigest()[:40]


def _file(key: str) -> Path:
    return cache_folder() / "bounds" / f"{key}.json"


def _read(key: str) -> EpisodeBound | None:
    try:
        known = json.loads(_file(key).read_text(encoding="utf-8"))
        cost = math.inf if known["cost"] is None else float(known["cost"])
        starts = tuple(Start(**start) for start in known["starts"])
        return None if _lacks_starts(starts) else EpisodeBound(cost, starts)
    except (OSError, ValueError, KeyError, TypeError):
        return None  # not there, or not whole: it is computed


def _keep(key: str, optimum: OptimalEpisode) -> EpisodeBound:
    bound = EpisodeBound(optimum.cost, optimum.starts)
    cost = bound.cost if math.isfinite(bound.cost) else None
    with suppress(FileError):  # a cache that cannot be written is none
        write_json(_file(key), {"cost": cost, "starts": [asdict(start) for start in bound.starts]})
    return bound
