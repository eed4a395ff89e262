"""A named test set of one's own records: a folder with a manifest that says what each file is.

The manifest, ``motions.toml``, gives source, licence, SHA-256 and event of every file, and how it is
read where the file does not say so. Records of one event are not independent: results are given by
event as well.
"""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass, fields, replace
from os import PathLike
from pathlib import Path
from typing import Any

from rich.console import Console

from agents.motions.channels import MotionOptions, motion_earthquakes
from shake_env.errors import FileError, unknown
from shake_env.files import no_file
from shake_env.motion.targets import RecordedMotion
from shake_env.rollout import Earthquake
from shake_env.scenario.scenario import Scenario

MANIFEST = "motions.toml"
SCHEMA = 1
REQUIRED = ("file", "sha256", "source", "licence", "event")
# Of a file that does not state them itself, as the options of `shake compare --motion`.
READING = ("units", "sampling_interval", "column", "sheet", "remove_offset", "allow_large")


@dataclass(frozen=True, kw_only=True)
class SetMotion:
    """A file of a set."""

    file: Path
    event: str
    source: str
    licence: str
    sha256: str
    reading: dict[str, Any]  # of `READING`, those that are given


@dataclass(frozen=True)
class TestSet:
    """A set of recorded motions with a name."""

    __test__ = False  # no test of pytest's

    name: str
    motions: tuple[SetMotion, ...]

    def earthquakes(
        self, options: MotionOptions, scenario: Scenario, *, scale: bool, console: Console
    ) -> tuple[list[Earthquake], list[str]]:
        """Return an earthquake for every channel of every file, and the event of each.

        Raises
        ------
        RecordError
            If a file cannot be read.
        FileError
            If two entries give the same samples, such as a column by its title and by its number.
        """
        quakes: list[Earthquake] = []
        events: list[str] = []
        first: dict[Any, str] = {}
        for number, motion in enumerate(self.motions, 1):
            own = replace(options, **motion.reading)
            each = motion_earthquakes([motion.file], own, scenario, scale=scale, console=console)
            for quake in each:
                assert isinstance(quake.motion, RecordedMotion)  # it comes from a file
                key = (quake.motion.source.digest, quake.motion.source.sampling_interval)
                if first.setdefault(key, f"motion {number}") != f"motion {number}":
                    remedy = f"has the samples of {first[key]}: leave one of them out"
                    raise FileError(f"motion {number} of {self.name}", quake.name, remedy)
            quakes += each
            events += [motion.event] * len(each)
        return quakes, events

    def to_json(self) -> dict[str, Any]:
        """Return name and files with source, licence, digest and event, as plain JSON values."""
        files = [
            {name: str(getattr(motion, name)) for name in REQUIRED if name != "file"}
            | {"file": motion.file.name}
            for motion in self.motions
        ]
        return {"name": self.name, "files": files}


def read_motion_set(folder: str | PathLike[str]) -> TestSet:
    """Return the set that a folder holds; its manifest may be named in place of the folder.

    Raises
    ------
    FileError
        If there is no manifest, it is no TOML, a field is unknown, missing, empty or of another type, a
        file is missing, named twice or outside of the folder, or its digest differs.
    """
    folder = Path(folder)
    if folder.is_file():  # the manifest itself is as good
        if folder.name != MANIFEST:
            remedy = f"is no folder: name the folder that holds {MANIFEST}"
            raise FileError("motion_set", str(folder), remedy)
        folder = folder.parent
    manifest = folder / MANIFEST
    if not manifest.is_file():
        remedy = f"{no_file(manifest)}: describe the records in it, see docs/howto/record.md"
        raise FileError("motion_set", str(manifest), remedy)
    try:
        content = tomllib.loads(manifest.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise FileError("motion_set", str(manifest), f"is no TOML: {error}") from error
    _known(manifest, "", content, ("schema", "name", "motion"))
    if content.get("schema") != SCHEMA:
        raise _fault(manifest, "schema", content.get("schema"), f"must be {SCHEMA}")
    name = _text(manifest, "name", content.get("name"))
    entries = content.get("motion")
    if not isinstance(entries, list) or not entries:
        raise _fault(manifest, "motion", entries, "give at least one [[motion]]")
    motions = tuple(_motion(manifest, number, entry) for number, entry in enumerate(entries, 1))
    for number, motion in enumerate(motions, 1):
        for before, other in enumerate(motions[: number - 1], 1):
            if motion.sha256.lower() == other.sha256.lower() and _overlap(motion, other):
                whole = (
                    ""
                    if "column" in motion.reading and "column" in other.reading
                    else ("; an entry without a column takes every column")
                )
                remedy = f"is named twice, see motion {before}{whole}"
                raise _fault(manifest, f"motion {number}.file", motion.file.name, remedy)
    return TestSet(name, motions)


def _overlap(one: SetMotion, other: SetMotion) -> bool:
    """Return whether two entries of one content share a channel; without a column it is every one."""
    parts = [(one.reading.get(key), other.reading.get(key)) for key in ("sheet", "column")]
    return all(a is None or b is None or a == b for a, b in parts)


def _motion(manifest: Path, number: int, entry: Any) -> SetMotion:
    where = f"motion {number}"
    if not isinstance(entry, dict):
        raise _fault(manifest, where, entry, "must be a table [[motion]]")
    _known(manifest, f"{where}.", entry, (*REQUIRED, *READING))
    words = {key: _text(manifest, f"{where}.{key}", entry.get(key)) for key in REQUIRED}
    file = manifest.parent / words["file"]
    if manifest.parent.resolve() not in file.resolve().parents:
        raise _fault(manifest, f"{where}.file", words["file"], "must lie in the folder of the set")
    if not file.is_file():
        raise _fault(manifest, f"{where}.file", words["file"], no_file(file))
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    if words["sha256"].lower() != digest:
        remedy = f"{words['file']} has {digest}: it is another file, or the digest is wrong"
        raise _fault(manifest, f"{where}.sha256", words["sha256"], remedy)
    reading = {key: entry[key] for key in READING if key in entry}
    if "column" in reading:
        reading["column"] = str(reading["column"])
    kinds = {"remove_offset": bool, "allow_large": bool, "sampling_interval": (int, float)}
    for key, value in reading.items():
        kind: Any = kinds.get(key, str)
        if not isinstance(value, kind) or (isinstance(value, bool) and kind is not bool):
            raise _fault(
                manifest, f"{where}.{key}", value, "is of another type, see shake compare --help"
            )
    assert set(READING) <= {field.name for field in fields(MotionOptions)}
    words.pop("file")
    return SetMotion(file=file, reading=reading, **words)


def _text(manifest: Path, key: str, value: Any) -> str:
    if not isinstance(value, str) or not value.strip():
        why = "is missing" if value is None else "must be words"
        raise _fault(manifest, key, value, f"{why}: every record states {', '.join(REQUIRED)}")
    return value


def _known(manifest: Path, where: str, content: dict[str, Any], names: tuple[str, ...]) -> None:
    for key in content:
        if key not in names:
            error = unknown(FileError, "field", key, names)
            raise _fault(manifest, f"{where}{key}", content[key], error.remedy)


def _fault(manifest: Path, key: str, value: Any, remedy: str) -> FileError:
    return FileError(f"{manifest}, {key}", value, remedy)
