"""The posterior of a table and a specimen: samples, where they come from, and its file."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.laboratory.identification.fit import Fit
from agents.laboratory.identification.parameters import LINEAR, Prior, from_scale, require_parameter
from agents.laboratory.logs.test_log import scenario_of_text, text_of_scenario, unit_of
from agents.plain_values import entry, of_type
from shake_env.errors import FileError, ShakeError
from shake_env.files import write_text
from shake_env.model.parameters import FloatArray
from shake_env.model.specimen_state import SpecimenState, is_state_value
from shake_env.scenario.digest import scenario_digest
from shake_env.scenario.plants.samples import FORMAT, VERSION, PlantSamples, read_posterior_file
from shake_env.scenario.scenario import Scenario

WIDEST = (
    1e-9  # added to a covariance of samples, of a squared prior deviation, so that it has an inverse
)
RESTORE = "restore the file from a copy, or write it anew by shake identify or shake sequence"


@dataclass(frozen=True)
class Posterior:
    """Samples of the parameters of one table and specimen."""

    scenario: Scenario  # nominal model, without what is drawn
    names: tuple[str, ...]
    points: FloatArray  # (samples, p) on the parameters' scales
    method: str  # laplace or ensemble
    seed: int
    logs: tuple[tuple[str, str], ...]  # name and digest of the data of each log
    shares: tuple[tuple[str, float], ...]  # discrepancy of each channel, the largest of all logs [-]
    states: tuple[SpecimenState, ...] = ()  # damage of the specimen by sample; (): as new
    r_hat: tuple[float, ...] | None = None  # of each parameter; None: independent draws
    effective: tuple[float, ...] | None = None  # effective sample size of each parameter

    @classmethod
    def from_fit(cls, fit: Fit, samples: int, seed: int) -> Posterior:
        """Return the normal posterior of a fit by independent draws."""
        likelihood = fit.likelihood
        largest: dict[str, float] = {}
        for each, share in zip(likelihood.data, likelihood.shares, strict=True):
            for name, value in zip(each.channels, share.tolist(), strict=True):
                largest[name] = max(value, largest.get(name, 0.0))
        return cls(
            scenario=likelihood.scenario,
            names=fit.names,
            points=fit.draw(samples, np.random.default_rng(seed)),
            method="laplace",
            seed=seed,
            logs=tuple((each.log.name, each.log.sha256) for each in likelihood.data),
            shares=tuple(largest.items()),
        )

    @property
    def values(self) -> FloatArray:
        """Samples (samples, p) in SI."""
        return from_scale(self.names, self.points)

    @property
    def mean(self) -> dict[str, float]:
        """Value in SI of the mean on each parameter's scale."""
        middle = from_scale(self.names, self.points.mean(axis=0))
        return dict(zip(self.names, middle.tolist(), strict=True))

    @property
    def nominal(self) -> Scenario:
        """The scenario at the posterior's mean: what controllers are designed on."""
        return self.scenario.with_plant(self.mean)

    @property
    def uncertain(self) -> Scenario:
        """The scenario at the mean, with the samples as its uncertainty."""
        names, rows = self._named_rows()
        samples = PlantSamples(
            names=names,
            rows=rows,
            channels=tuple(name for name, _ in self.shares),
            shares=tuple(share for _, share in self.shares),
        )
        return replace(self.nominal, uncertainty=samples)

    def _named_rows(self) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
        """Return the names of a sample's values, damage included, and the values of each sample, SI."""
        rows = tuple(map(tuple, self.values.tolist()))
        if not any(state.damaged for state in self.states):
            return self.names, rows
        damages = [tuple(state.values.values()) for state in self.states]
        names = (*self.names, *self.states[0].values)
        return names, tuple((*row, *more) for row, more in zip(rows, damages, strict=True))

    def prior(self) -> Prior:
        """Return the normal prior of the next update: mean and covariance of the samples."""
        covariance = np.atleast_2d(np.cov(self.points.T))
        ridge = WIDEST + 1e-12 * np.diag(covariance)
        return Prior(self.names, self.points.mean(axis=0), covariance + np.diag(ridge))

    def interval(self, probability: float = 0.9) -> dict[str, tuple[float, float]]:
        """Return the central interval of each parameter, SI."""
        ends = [0.5 - 0.5 * probability, 0.5 + 0.5 * probability]
        low, high = np.quantile(self.values, ends, axis=0)
        return {n: (float(a), float(b)) for n, a, b in zip(self.names, low, high, strict=True)}

    def write(self, file: str | os.PathLike[str]) -> None:
        """Write the file, which `[uncertainty.posterior]` of a scenario's file names."""
        file = Path(file)
        names, rows = self._named_rows()
        content: dict[str, Any] = {
            "format": FORMAT,
            "version": VERSION,
            "names": list(names),
            "linear": [name for name in self.names if name in LINEAR],
            "method": self.method,
            "seed": self.seed,
            "logs": [list(pair) for pair in self.logs],
            "shares": dict(self.shares),
            "r_hat": None if self.r_hat is None else list(self.r_hat),
            "effective": None if self.effective is None else list(self.effective),
            "digest": scenario_digest(self.scenario),
            "scenario": json.loads(text_of_scenario(self.scenario)),
            "samples": rows,
        }
        write_text(file, json.dumps(content) + "\n")


def read_posterior(file: str | os.PathLike[str]) -> Posterior:
    """Return the posterior of a file.

    Raises
    ------
    FileError
        If it cannot be read, is none, or its scenario is not that of its digest.
    """
    file = Path(file)
    content = read_posterior_file(file)
    try:
        scenario = entry(
            content, "scenario", lambda value: scenario_of_text(json.dumps(value)), "a scenario"
        )
        columns: list[str] = content["names"]
        names = tuple(name for name in columns if not is_state_value(name))
        for name in names:
            require_parameter(name, scenario)
        if len(set(columns)) < len(columns) or not names:
            raise ValueError("'names' must hold each parameter once, one at least")
        samples = entry(content, "samples", _table(len(columns)), f"rows of {len(columns)} numbers")
        states = _states(columns, samples, scenario.specimen.stories)
        samples = samples[:, [columns.index(name) for name in names]]
        for name, column in zip(names, samples.T, strict=True):
            if not np.isfinite(column).all() or not (name in LINEAR or (column > 0.0).all()):
                raise ValueError(f"the samples of {name!r} must be finite, and above 0")
        points = np.where([n in LINEAR for n in names], samples, np.log(np.maximum(samples, 1e-300)))
        each = _numbers(len(names))
        text = f"null or {len(names)} numbers"
        posterior = Posterior(
            scenario=scenario,
            names=names,
            points=points,
            method=entry(content, "method", of_type(str), "a text"),
            seed=entry(content, "seed", of_type(int), "a whole number"),
            logs=entry(
                content, "logs", lambda rows: tuple((str(a), str(b)) for a, b in rows),
                "pairs of name and digest",
            ),
            shares=entry(content, "shares", _shares, "numbers of at least 0 by channel"),
            states=states,
            r_hat=entry({"r_hat": None, **content}, "r_hat", each, text),
            effective=entry({"effective": None, **content}, "effective", each, text),
        )  # fmt: skip
    except ShakeError as error:
        raise FileError(f"{file}, {error.field}", error.value, f"{error.remedy}; {RESTORE}") from None
    except ValueError as error:
        raise FileError("posterior", str(file), f"is damaged: {error}; {RESTORE}") from None
    if content.get("digest") != scenario_digest(scenario):
        remedy = f"is not that of its scenario: the file was edited; {RESTORE}"
        raise FileError(f"{file}, digest", content.get("digest"), remedy)
    return posterior


def _table(width: int) -> Callable[[list[list[float]]], FloatArray]:
    def convert(rows: list[list[float]]) -> FloatArray:
        table = np.array(rows, dtype=float)
        if table.ndim != 2 or table.shape[1] != width or not len(table):
            raise ValueError
        return table

    return convert


def _numbers(length: int) -> Callable[[Any], tuple[float, ...] | None]:
    def convert(values: Any) -> tuple[float, ...] | None:
        if values is None:
            return None
        if len(values) != length:
            raise ValueError
        return tuple(float(value) for value in values)

    return convert


def _shares(values: dict[str, Any]) -> tuple[tuple[str, float], ...]:
    shares = tuple((str(key), float(value)) for key, value in values.items())
    if not all(0.0 <= share < math.inf for _, share in shares):
        raise ValueError
    for name, _ in shares:
        unit_of(name)
    return shares


def _states(columns: list[str], samples: FloatArray, stories: int) -> tuple[SpecimenState, ...]:
    """Return the damage of each sample (samples, columns); (): as new."""
    if not any(is_state_value(name) for name in columns):
        return ()
    rows = (dict(zip(columns, row, strict=True)) for row in samples.tolist())
    states = (SpecimenState.from_values(row, stories) for row in rows)
    return tuple(state for state in states if state is not None)
