"""What a scenario needs in memory, estimated from its sizes and refused before it is taken."""

from __future__ import annotations

import math
import os
from contextlib import suppress
from pathlib import Path

from shake_env import numba_support
from shake_env.errors import ScenarioError
from shake_env.model.discretization import MOST_DIRECTIONS
from shake_env.motion.targets import FilteredNoise, MotionSet
from shake_env.scenario.scenario import Scenario

NUMBER = 8  # [bytes]
GENERATOR = 100  # numbers that a table's random generator takes, and what else Python holds of it
SHARE = 0.8  # of what is free
UNKNOWN = 8 * 2**30  # [bytes] taken to be free where the operating system does not say
EXPONENTIAL = 12  # matrices that scipy's matrix exponential holds at once


def memory_needed(scenario: Scenario, lanes: int) -> int:
    """Return about how many bytes `lanes` tables of a scenario take, their design included.

    From the sizes of the arrays: 0.8 to 3 times the measured peak where that is over 10 MB. Every motion
    of a set is counted, though an episode plays one.
    """
    stories, k = scenario.specimen.stories, scenario.substeps
    order = scenario.ground.states + 4 + 4 * stories
    exogenous = scenario.ground.states + 2 * stories
    draws = k * (scenario.noise_directions or MOST_DIRECTIONS)
    commands = math.ceil(scenario.longest_delay / k)
    slips = stories if scenario.parts.yielding.active else 0
    table = 4 + 2 * stories + slips + len(scenario.observation.low_passes) + commands + 1
    drive = table + 2 * k if scenario.equations.specimen_feels_target else 0
    width = exogenous + 2 * k + drive
    inputs = order + 1 + draws
    # Of the noise covariance, the largest, and of the table; compiled code has one workspace for all.
    workspace = EXPONENTIAL * ((2 * order) ** 2 + (table + 4) ** 2)
    maps = (
        2 * (order + 4 * k) * inputs  # one control period as one map, and the one under a record
        + 2 * (order + 3 * k) * (order + 2 + k)
        + width * (exogenous + draws)
        + k * (commands + 1)
    )
    plants = lanes if scenario.uncertainty.active else 1
    design = maps * plants + workspace * (1 if numba_support.COMPILED else plants)
    samples, spacing = scenario.sensing.preview_steps(scenario.physics_step)
    slots = 1 + math.ceil(samples * spacing / k)  # of the ring of periods
    readings = 0 if scenario.sensing.full_state else len(scenario.sensing.sensors or ()) + stories
    observation = scenario.observation.size
    # A record of each table, and two memories that steps hand out in turn, in single precision.
    record = table + 2 * k + slots * width + 6 * readings + observation + 40
    buffers = lanes * (record + 3 * (observation // 2 + 16) + GENERATOR)
    return NUMBER * (design + buffers + _motions(scenario))


def _motions(scenario: Scenario) -> int:
    """Return how many numbers the histories and envelopes of a scenario's motions hold."""
    motion = scenario.motion
    numbers = 0.0
    for each in motion.motions if isinstance(motion, MotionSet) else (motion,):
        if not isinstance(each, FilteredNoise):
            duration = each.source.duration / each.time_compression
            numbers += (14 + scenario.ground.states) * duration / scenario.physics_step
        elif each.envelope is not None:
            numbers += 6.0 * each.duration / scenario.physics_step
    return math.ceil(numbers)


def memory_free() -> int:
    """Return how many bytes are free, by the kernel's count and within the limit of a container."""
    free = UNKNOWN
    with suppress(AttributeError, OSError, ValueError):  # not on Windows
        free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with suppress(OSError, ValueError, IndexError):  # no Linux, or no container
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                free = int(line.split()[1]) * 1024
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        if limit != "max":
            used = int(Path("/sys/fs/cgroup/memory.current").read_text(encoding="ascii"))
            free = min(free, int(limit) - used)
    return free


def check_memory(scenario: Scenario, lanes: int) -> None:
    """Raise ScenarioError if `lanes` tables of a scenario need more than four fifths of what is free."""
    needed, free = memory_needed(scenario, lanes), memory_free()
    if needed > SHARE * free:
        size = {
            "num_envs": lanes,
            "stories": scenario.specimen.stories,
            "physics steps a control period": scenario.substeps,
            "numbers an observation": scenario.observation.size,
        }
        raise ScenarioError(
            "memory",
            f"{needed / 2**30:.3g} GiB",
            f"is needed and {free / 2**30:.3g} GiB are free: lower one of "
            + ", ".join(f"{name} ({value})" for name, value in size.items()),
        )
