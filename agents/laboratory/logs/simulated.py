"""Simulated tests written as logs, one file a controller and earthquake."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path

from agents.evaluation.controller_set import get_controllers
from agents.laboratory.logs.log_file import write_log
from agents.laboratory.logs.recorder import LogRecorder
from baselines.tuned_values import TunedValues
from shake_env.rollout import Earthquake, rollout
from shake_env.safety.supervisor import Supervised
from shake_env.scenario.scenario import Scenario


def write_logs(
    scenario: Scenario,
    names: Sequence[str],
    earthquakes: Sequence[Earthquake],
    folder: str | os.PathLike[str],
    *,
    tuned: TunedValues | None = None,
    supervised: bool = False,
    on_progress: Callable[[str, float], None] = lambda controller, share: None,
) -> list[Path]:
    """Run controllers on earthquakes and write the log of each test as HDF5; return the files.

    Equal seeds make these the same tests as those of `agents.evaluation.comparison.compare`. The
    oracle, which no laboratory has, is left out.

    Parameters
    ----------
    scenario, names, earthquakes, tuned, supervised
        As `compare` takes them.
    folder
        For the files.
    on_progress
        Told the controller that runs and its share done, 0 to 1.
    """
    folder = Path(folder)
    written = []
    for name, each in get_controllers(names, scenario, earthquakes, tuned).controllers.items():
        recorder = LogRecorder(scenario, earthquakes)
        controller = Supervised(each, scenario) if supervised else each

        def report(share: float, name: str = name) -> None:
            on_progress(name, share)

        rollout(controller, scenario, earthquakes, on_step=report, log=recorder)
        for log in recorder.logs(Path(name).stem):
            file = folder / (re.sub(r"[^\w.-]+", "_", log.name).strip("._") + ".h5")
            write_log(log, file)
            written.append(file)
    return written
