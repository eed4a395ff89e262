"""Files of tuned parameter values; an entry belongs to the scenario that it was tuned on, by digest."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from os import PathLike
from pathlib import Path
from typing import Any

from shake_env.errors import ParameterError
from shake_env.files import no_file, write_text
from shake_env.model.parameters import is_number
from shake_env.renamed import CONTROLLERS, TUNABLES, renamed, renamed_keys

FORMAT = "shake-tuned-1"
_REMEDY = "is no file of tuned values: shake tune CONTROLLER --output FILE writes one"


@dataclass(frozen=True, kw_only=True)
class TunedEntry:
    """What a search found for one controller on one scenario."""

    controller: str
    digest: str  # of the scenario, see `shake_env.scenario.digest`
    scenario: str  # its name then, for a reader; it decides nothing
    parameters: Mapping[str, float]
    search: Mapping[str, Any] = field(default_factory=dict)  # budget, costs, seed, version

    def to_json(self) -> dict[str, Any]:
        """Return the entry as plain JSON values."""
        return {**vars(self), "parameters": dict(self.parameters), "search": dict(self.search)}


@dataclass(frozen=True)
class TunedValues:
    """The entries of a file."""

    source: str  # its path, for a reader
    entries: tuple[TunedEntry, ...] = ()

    def exact(self, controller: str, digest: str) -> TunedEntry | None:
        """Return the entry that was tuned on the scenario with this digest, if there is one."""
        suit = (e for e in self.entries if (e.controller, e.digest) == (controller, digest))
        return next(suit, None)

    def of_scenario(self, digest: str) -> TunedValues:
        """Return the entries that were tuned on the scenario with this digest."""
        return TunedValues(self.source, tuple(e for e in self.entries if e.digest == digest))

    def only(self, controller: str) -> TunedEntry | None:
        """Return the controller's one entry, whatever it was tuned on; None: there is none.

        Raises
        ------
        ParameterError
            If there are several, of which none is the one to take.
        """
        of_controller = [entry for entry in self.entries if entry.controller == controller]
        if len(of_controller) > 1:
            names = ", ".join(entry.scenario for entry in of_controller)
            raise ParameterError(
                "tuned",
                self.source,
                f"holds values of {controller} for several scenarios ({names}), none of them this one: "
                "tune on this one, or give a file with one of them",
            )
        return of_controller[0] if of_controller else None

    def with_entry(self, entry: TunedEntry) -> TunedValues:
        """Return the values with an entry added, in place of the one for the same scenario."""
        key = (entry.controller, entry.digest)
        others = [e for e in self.entries if (e.controller, e.digest) != key]
        ordered = sorted([*others, entry], key=lambda e: (e.scenario, e.controller, e.digest))
        return TunedValues(self.source, tuple(ordered))


LARGEST = 16 * 2**20  # [byte] of a file of tuned values; that of the package has 30 000


def read_tuned(file: str | os.PathLike[str]) -> TunedValues:
    """Read a file of tuned values.

    Raises
    ------
    ParameterError
        If it cannot be read, or is no such file.
    """
    path = Path(file)
    try:
        if not path.is_file():  # a pipe or a device would not end
            raise ParameterError("tuned", str(file), f"{no_file(path)}; {_REMEDY}")
        if path.stat().st_size > LARGEST:
            raise ParameterError("tuned", str(file), f"is larger than {LARGEST} byte: {_REMEDY}")
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise ParameterError("tuned", str(file), f"cannot be read ({reason}): {_REMEDY}") from error
    return parse_tuned(text, str(file))


def parse_tuned(text: str, source: str) -> TunedValues:
    """Return the tuned values that a file's text holds; see `read_tuned`."""
    try:
        plain = json.loads(text)
    except (json.JSONDecodeError, RecursionError) as error:
        raise ParameterError("tuned", source, f"is no JSON ({error}): {_REMEDY}") from error
    entries = plain.get("entries") if isinstance(plain, dict) else None
    if not isinstance(entries, list) or plain.get("format") != FORMAT:
        raise ParameterError("tuned", source, f"has no format {FORMAT!r} with entries: {_REMEDY}")
    return TunedValues(source, tuple(_entry(e, number, source) for number, e in enumerate(entries)))


def _entry(plain: Any, number: int, source: str) -> TunedEntry:
    names = ("controller", "digest", "scenario")
    if not isinstance(plain, dict) or not all(isinstance(plain.get(name), str) for name in names):
        raise ParameterError("tuned", source, f"entry {number} lacks one of {', '.join(names)}")
    parameters, search = plain.get("parameters"), plain.get("search", {})
    if (
        not isinstance(parameters, dict)
        or not isinstance(search, dict)
        or not all(is_number(v) and math.isfinite(v) for v in parameters.values())
    ):
        raise ParameterError("tuned", source, f"entry {number}: parameters must be finite numbers")
    controller = renamed("controller", plain["controller"], CONTROLLERS)
    values = {name: float(value) for name, value in parameters.items()}
    return TunedEntry(
        controller=controller,
        digest=plain["digest"],
        scenario=plain["scenario"],
        parameters=renamed_keys(f"parameter of {controller}", values, TUNABLES.get(controller, {})),
        search=search,
    )


def write_tuned(values: TunedValues, file: str | PathLike[str]) -> None:
    """Write a file of tuned values; a reader never sees half of it."""
    file = Path(file)
    plain = {"format": FORMAT, "entries": [entry.to_json() for entry in values.entries]}
    write_text(file, json.dumps(plain, indent=1, sort_keys=True) + "\n")


@lru_cache(maxsize=1)
def packaged_values() -> TunedValues:
    """Return the values that come with the package."""
    file = resources.files("baselines") / "tuned.json"
    return parse_tuned(file.read_text(encoding="utf-8"), "baselines/tuned.json")
