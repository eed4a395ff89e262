"""Plants known by samples of their posterior, which identification writes, as an uncertainty."""

from __future__ import annotations

import json
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from shake_env.errors import FileError, ParameterError
from shake_env.files import no_file
from shake_env.scenario.uncertainty import Uncertainty

FORMAT, VERSION = "shake_env posterior", 1
LARGEST = 100_000_000  # bytes


@dataclass(frozen=True, kw_only=True)
class PlantSamples(Uncertainty):
    """Joint samples of a plant's parameters: a reset draws one row.

    Raises
    ------
    ParameterError
        If there is no sample, a row has another length than the names, or a number is not finite.
    """

    names: tuple[str, ...] = ()  # of the parameters, as `Scenario.with_plant` takes them
    rows: tuple[tuple[float, ...], ...] = ()  # of each sample, SI
    channels: tuple[str, ...] = ()  # measured channels whose model has an error
    shares: tuple[float, ...] = ()  # standard deviation of that error [-] of the channel's response

    def __post_init__(self) -> None:
        for name in ("names", "channels"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "shares", tuple(map(float, self.shares)))
        if len(self.channels) != len(self.shares) or not all(0.0 <= s < math.inf for s in self.shares):
            raise ParameterError("shares", self.shares, f"must be one for each of {self.channels}")
        object.__setattr__(self, "rows", tuple(tuple(map(float, row)) for row in self.rows))
        if not self.names or len(set(self.names)) < len(self.names) or not self.rows:
            raise ParameterError("names, rows", (self.names, len(self.rows)), "must hold a sample")
        for number, row in enumerate(self.rows):
            if len(row) != len(self.names) or not all(map(math.isfinite, row)):
                remedy = f"must hold {len(self.names)} finite numbers"
                raise ParameterError(f"rows[{number}]", row, remedy)

    @property
    def active(self) -> bool:
        """Whether anything is drawn."""
        return True

    def sample(self, stream: np.random.Generator, stories: int) -> dict[str, float]:
        """Return the values of one sample, by name."""
        return self.at(int(stream.integers(len(self.rows))))

    def at(self, number: int) -> dict[str, float]:
        """Return the values of a sample, by name."""
        return dict(zip(self.names, self.rows[number], strict=True))

    @property
    def middle(self) -> dict[str, float]:
        """Mean value of each parameter, by name: geometric where all are above 0, but for the delay."""
        columns = np.array(self.rows)
        means = columns.mean(axis=0)
        positive = (columns > 0.0).all(axis=0) & (np.array(self.names) != "delay")
        means[positive] = np.exp(np.log(columns[:, positive]).mean(axis=0))
        return dict(zip(self.names, means.tolist(), strict=True))

    def largest(self, name: str) -> float | None:
        """Return the largest value of a parameter; None where it is not among them."""
        if name not in self.names:
            return None
        place = self.names.index(name)
        return max(row[place] for row in self.rows)


def read_posterior_file(file: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the content of a posterior file, its fields checked for their types.

    Raises
    ------
    FileError
        If it cannot be read or is none.
    """
    path = Path(file)
    if not path.is_file():
        raise FileError("posterior", str(path), no_file(path))
    try:
        if path.stat().st_size > LARGEST:
            raise FileError("posterior", str(path), f"is larger than {LARGEST // 10**6} MB")
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileError("posterior", str(path), f"cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, FileError):
            raise
        raise FileError("posterior", str(path), f"is no JSON ({error})") from None
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise FileError("posterior", str(path), "is no file of shake identify")
    if content.get("version") != VERSION:
        raise FileError(f"{path}, version", content.get("version"), f"must be {VERSION}")
    names, samples = content.get("names"), content.get("samples")
    if not (isinstance(names, list) and all(isinstance(n, str) for n in names)):
        raise FileError(f"{path}, names", names, "must be texts")
    if not (isinstance(samples, list) and all(isinstance(row, list) for row in samples)):
        raise FileError(f"{path}, samples", type(samples).__name__, "must be rows of numbers")
    for row in samples:
        if not all(isinstance(v, int | float) and not isinstance(v, bool) for v in row):
            raise FileError(f"{path}, samples", row[:4], "must be numbers")
    return content


def read_samples(file: str | os.PathLike[str]) -> PlantSamples:
    """Return the samples of a posterior file as a scenario's uncertainty.

    Raises
    ------
    FileError
        If it cannot be read or is none.
    ParameterError
        If a sample is not complete.
    """
    content = read_posterior_file(file)
    shares = content.get("shares", {})
    numbers = isinstance(shares, dict) and all(isinstance(v, int | float) for v in shares.values())
    if not numbers:
        raise FileError(f"{file}, shares", shares, "must be numbers by channel")
    return PlantSamples(
        names=content["names"],
        rows=content["samples"],
        channels=tuple(shares),
        shares=tuple(shares.values()),
    )
