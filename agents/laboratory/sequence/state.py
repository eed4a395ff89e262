"""The state of a sequence: a folder with one JSON file and a posterior for each shake.

Every action reads the file, does its work and replaces the file whole: after an interruption the same
action is given again, and goes on from what is there.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from agents.laboratory.identification.posterior import Posterior, read_posterior
from agents.laboratory.logs.log_file import read_log
from agents.laboratory.logs.test_log import TestLog, scenario_of_text, text_of_scenario
from agents.plain_values import entry, of_type, typed
from shake_env.errors import FileError, ParameterError, ShakeError
from shake_env.files import no_file, write_json
from shake_env.scenario.scenario import Scenario

FORMAT, VERSION = "shake_env sequence", 1
FILE = "sequence.json"
RESTORE = "restore the file from a copy, or begin anew with shake sequence plan in another folder"


@dataclass(frozen=True)
class Shake:
    """One step of a sequence."""

    amplitude: float  # [-] of the full motion
    controller: str | None = None  # chosen by the forecast; None: not forecast yet
    forecast: Mapping[str, Any] | None = None  # its intervals, as `page.forecast_to_json` writes them
    override: str | None = None  # reason why an unsafe shake is made all the same
    log: tuple[str, str] | None = None  # name and digest of the log that closed it
    measured: Mapping[str, float] | None = None  # rms and peak of each channel
    # whether each lies within its interval; none where the log does not hold the whole motion
    inside: Mapping[str, bool] | None = None
    # damage after it: low end, median and high end of the belief in each value of `SpecimenState` and in
    # each storey's remaining drift, SI
    damage: Mapping[str, Any] | None = None
    # seconds that its log holds, and of its motion, where the log ends before it; None: it is whole
    covered: tuple[float, float] | None = None

    @property
    def closed(self) -> bool:
        """Whether its log has been read."""
        return self.log is not None


@dataclass(frozen=True)
class Sequence:
    """Plan and history of one specimen."""

    folder: Path
    scenario: Scenario  # with the full motion; its uncertainty is the first belief
    controllers: tuple[str, ...]
    required_probability: float  # with which every limit must be kept
    probability: float  # of the intervals
    samples: int
    seed: int
    shakes: tuple[Shake, ...] = field(default=())

    @property
    def number(self) -> int:
        """Number of closed shakes, which is the place of the next one."""
        return sum(shake.closed for shake in self.shakes)

    @property
    def next(self) -> Shake:
        """The next shake.

        Raises
        ------
        ParameterError
            If all are done.
        """
        if self.number == len(self.shakes):
            raise ParameterError("sequence", str(self.folder), f"all {self.number} shakes are done")
        return self.shakes[self.number]

    @property
    def posterior(self) -> Posterior:
        """The present belief."""
        return read_posterior(self.posterior_file(self.number))

    @property
    def logs(self) -> list[TestLog]:
        """The logs that closed shakes, in order, from the sequence's own folder."""
        return [read_log(self.shake_folder(i) / "log.h5") for i in range(1, self.number + 1)]

    def shake_folder(self, number: int) -> Path:
        """Return the folder of a shake, counted from 1."""
        return self.folder / f"shake_{number}"

    def posterior_file(self, number: int) -> Path:
        """Return the file of the belief after some shakes."""
        return self.folder / f"posterior_{number}.json"

    @property
    def calibration(self) -> float | None:
        """Share of measured figures that lay within their intervals so far; None before the first."""
        flags = [flag for shake in self.shakes for flag in (shake.inside or {}).values()]
        return sum(flags) / len(flags) if flags else None

    def with_next(self, **changes: Any) -> Sequence:
        """Return the sequence with changes of its next shake."""
        shakes = list(self.shakes)
        shakes[self.number] = replace(self.next, **changes)
        return replace(self, shakes=tuple(shakes))

    def write(self) -> None:
        """Replace the file."""
        content = {
            "format": FORMAT,
            "version": VERSION,
            "scenario": json.loads(text_of_scenario(self.scenario)),
            "controllers": list(self.controllers),
            "required_probability": self.required_probability,
            "probability": self.probability,
            "samples": self.samples,
            "seed": self.seed,
            "shakes": [asdict(shake) for shake in self.shakes],
        }
        write_json(self.folder / FILE, content)


def read_sequence(folder: str | os.PathLike[str]) -> Sequence:
    """Return the sequence of a folder.

    Raises
    ------
    FileError
        If there is none, or its file is damaged.
    """
    folder = Path(folder)
    path = folder / FILE
    if not path.is_file():
        raise FileError("sequence", str(path), f"{no_file(path)}: begin with shake sequence plan")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(content, dict):
            raise ValueError("the whole must be a JSON object")
        if entry(content, "format", of_type(str), "a text") != FORMAT:
            raise ValueError(f"'format' must be {FORMAT!r}")
        if entry(content, "version", of_type(int), "a whole number") != VERSION:
            raise FileError(
                f"{path}, version", content["version"], f"must be {VERSION}: use that version's program"
            )
        shakes = [
            typed(Shake, each, f"shake {i}")
            for i, each in enumerate(entry(content, "shakes", of_type(list[Any]), "a list"), 1)
        ]
        for shake in shakes:
            _require_intervals(shake.forecast)
        return Sequence(
            folder=folder,
            scenario=entry(
                content, "scenario", lambda value: scenario_of_text(json.dumps(value)), "a scenario"
            ),
            controllers=entry(content, "controllers", of_type(tuple[str, ...]), "a list of names"),
            required_probability=entry(content, "required_probability", of_type(float), "a number"),
            probability=entry(content, "probability", of_type(float), "a number"),
            samples=entry(content, "samples", of_type(int), "a whole number"),
            seed=entry(content, "seed", of_type(int), "a whole number"),
            shakes=tuple(shakes),
        )
    except OSError as error:
        raise FileError("sequence", str(path), f"cannot be read ({error.strerror})") from None
    except FileError:
        raise
    except ShakeError as error:
        raise FileError(f"{path}, {error.field}", error.value, f"{error.remedy}; {RESTORE}") from None
    except (ValueError, RecursionError) as error:
        text = "nested too deeply" if isinstance(error, RecursionError) else error
        raise FileError("sequence", str(path), f"is damaged: {text}; {RESTORE}") from None


def _require_intervals(forecast: Mapping[str, Any] | None) -> None:
    """Raise ValueError where a forecast holds no intervals of three numbers each."""
    if forecast is None:
        return
    intervals = forecast.get("intervals")
    if not isinstance(intervals, Mapping):
        raise ValueError("a forecast holds no intervals")
    for name, interval in intervals.items():
        if (
            not isinstance(interval, list)
            or len(interval) != 3
            or not all(isinstance(each, int | float) for each in interval)
        ):
            raise ValueError(f"the interval of {name} is not three numbers")


def state_of(sequence: Sequence) -> dict[str, Any]:
    """Return a sequence for a person: each shake's amplitude, controller and what came of it."""
    return {
        "folder": str(sequence.folder),
        "done": sequence.number,
        "calibration": sequence.calibration,
        "shakes": [
            {
                "amplitude": shake.amplitude,
                "controller": shake.controller,
                "override": shake.override,
                "log": None if shake.log is None else shake.log[0],
                "inside": shake.inside,
                "damage": shake.damage,
                "covered": shake.covered,
            }
            for shake in sequence.shakes
        ],
    }
