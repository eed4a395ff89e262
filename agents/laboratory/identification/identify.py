"""Identification as one call: from logs and files to fit, posterior and unidentified parameters."""

from __future__ import annotations

import math
import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from agents.laboratory.identification.consistency import require_explained
from agents.laboratory.identification.fit import Fit, fit
from agents.laboratory.identification.identifiability import Unidentified, unidentified
from agents.laboratory.identification.likelihood import Likelihood, LogData
from agents.laboratory.identification.parameters import (
    LINEAR,
    Prior,
    default_prior,
    require_parameter,
)
from agents.laboratory.identification.plausibility import require_plausible, require_possible_command
from agents.laboratory.identification.posterior import Posterior, read_posterior
from agents.laboratory.identification.sampler import LEAST_SAMPLES, require_sampler, sample_posterior
from agents.laboratory.logs.test_log import CURRENT, TestLog, require_same_test
from agents.seeds import require_seed
from shake_env.errors import LogError, ParameterError, unknown
from shake_env.files import no_file
from shake_env.scenario.quantities import QuantityError, to_si
from shake_env.scenario.scenario import Scenario
from shake_env.scenario.scenario_file import read_scenario


@dataclass(frozen=True)
class Identified:
    """What logs tell of a table and its specimen."""

    fit: Fit
    posterior: Posterior
    unidentified: list[Unidentified]


def identify(
    logs: Sequence[TestLog],
    scenario: Scenario,
    *,
    prior: Prior | None = None,
    earlier: Sequence[TestLog] = (),
    without: Sequence[str] = (),
    band: tuple[float, float] | None = None,
    discrepancy: bool = True,
    samples: int = 2000,
    sampler_seconds: float = 0.0,
    sampler_moves: int | None = None,
    seed: int = 0,
    on_progress: Callable[[str, float], None] = lambda what, share: None,
) -> Identified:
    """Return the posterior of a scenario's parameters from logs of its tests.

    Parameters
    ----------
    logs
        Of tests on one table with one specimen, in the order in which the specimen bore them.
    scenario
        Model with the values before; its uncertainty widens the prior (`default_prior`).
    prior
        Of the parameters; None: `default_prior`.
    earlier
        Logs of tests that the specimen bore before these, which are in the prior: where storeys yield,
        the specimen begins with what they left.
    without, band
        Channels that are left out, and the frequencies [Hz] that are fitted; see `LogData.from_log`.
    discrepancy
        Whether what the model lacks is estimated.
    samples
        Number of samples of the posterior.
    sampler_seconds, sampler_moves
        Time or moves of the sampler; neither: the normal posterior (Laplace).
    seed
        Of everything drawn.
    on_progress
        Told what runs, and its share done.

    Raises
    ------
    LogError
        If a log is of another rate or table, or given twice, a channel has a fault, or the model
        explains a channel not at all.
    ParameterError
        If a number is outside its range, the prior names no parameter of the scenario, or as
        `LogData.from_log` says.
    """
    prior = default_prior(scenario) if prior is None else prior
    for name in prior.names:
        require_parameter(name, scenario)
    if samples < LEAST_SAMPLES:
        raise ParameterError("samples", samples, f"must be at least {LEAST_SAMPLES}")
    require_seed(seed)
    require_sampler(sampler_seconds, sampler_moves)
    data = [LogData.from_log(log, scenario, without, band) for log in logs]
    if not data:
        raise LogError("logs", 0, "give at least one")
    digests = [log.sha256 for log in logs]
    twice = [log.name for i, log in enumerate(logs) if log.sha256 in digests[:i]]
    if twice:
        raise LogError(twice[0], "given twice", "a log counts once: leave one of them out")
    for log in logs:
        require_possible_command(log, scenario)
    plain = replace(scenario, uncertainty=type(Scenario().uncertainty)())
    likelihood = Likelihood.from_data(
        plain, prior.names, data, [log.channels[CURRENT] for log in earlier]
    )
    require_plausible(likelihood, prior, seed)
    result = fit(
        likelihood,
        prior,
        discrepancy=discrepancy,
        seed=seed,
        on_progress=lambda share: on_progress("fit", share),
    )
    require_explained(result)
    if sampler_seconds > 0.0 or sampler_moves is not None:
        posterior = sample_posterior(
            result, samples=samples, seconds=sampler_seconds, moves=sampler_moves, seed=seed,
            on_progress=lambda share: on_progress("sampler", share),
        )  # fmt: skip
    else:
        posterior = Posterior.from_fit(result, samples, seed)
    return Identified(result, posterior, unidentified(result))


def model_of(
    logs: Sequence[TestLog],
    scenario: Scenario | None = None,
    table: Path | None = None,
    specimen: Path | None = None,
) -> Scenario:
    """Return the model that logs are held against.

    Parameters
    ----------
    logs
        Of tests.
    scenario
        Of logs that hold none; None: that of the first log.
    table, specimen
        Files whose table, or specimen, take its place.

    Raises
    ------
    LogError
        If a log was driven with another table, other sensors or another rate.
    """
    known = [log for log in logs if log.scenario_text is not None]
    if scenario is None:
        if not known:
            raise LogError(
                "scenario", None, "the logs hold none: give --scenario, or --table and --specimen"
            )
        scenario = known[0].scenario
    if table is not None:
        given = read_scenario(table)
        names = ("table", "actuator", "nonlinearity", "delay", "current_limit")
        scenario = replace(scenario, **{name: getattr(given, name) for name in names})
    if specimen is not None:
        given = read_scenario(specimen)
        yielding = given.nonlinearity.yielding
        parts = replace(scenario.nonlinearity, yielding=yielding)
        scenario = replace(scenario, specimen=given.specimen, nonlinearity=parts)
    for log in known:
        require_same_table(log, scenario)
    return scenario


def read_prior(file: str | os.PathLike[str], scenario: Scenario) -> Prior:
    """Return the prior of a file: a posterior of an earlier update, or TOML with medians and factors.

    In TOML a table for each parameter, ``[bulk_modulus]``, has ``median`` and ``factor`` (the standard
    deviation of the logarithm is ``log factor``); the delay has ``mean`` and ``deviation``. Parameters
    that are not named keep their default; ``parameters = [...]`` says which are estimated.

    Raises
    ------
    FileError
        If a posterior cannot be read.
    ParameterError
        If an entry is unknown or no quantity.
    """
    file = Path(file)
    if file.suffix == ".json":
        posterior = read_posterior(file)
        for name in posterior.names:
            require_parameter(name, scenario)
        return posterior.prior()
    if not file.is_file():
        raise ParameterError("prior", str(file), no_file(file))
    try:
        content = tomllib.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise ParameterError("prior", str(file), f"is no TOML: {error}") from None
    names = content.pop("parameters", None)
    if names is not None and not (isinstance(names, list) and all(isinstance(n, str) for n in names)):
        raise ParameterError(f"{file}, parameters", names, "must be a list of names")
    for name in names or ():
        require_parameter(name, scenario)
    given = {name: _given(name, entry, f"{file}, {name}", scenario) for name, entry in content.items()}
    return default_prior(scenario, names, given)


def _given(name: str, entry: Any, place: str, scenario: Scenario) -> tuple[float, float]:
    unit = require_parameter(name, scenario).unit
    middle, width = ("mean", "deviation") if name in LINEAR else ("median", "factor")
    if not isinstance(entry, dict) or middle not in entry or width not in entry:
        raise ParameterError(place, entry, f"must be a table with {middle} and {width}")
    for key in entry:
        if key not in (middle, width):
            raise unknown(ParameterError, f"entry of {place}", key, (middle, width))

    def number(value: Any, in_unit: str) -> float:
        try:
            if name in LINEAR and isinstance(value, str):
                return to_si(value, "s") / scenario.physics_step
            return to_si(value, in_unit) if isinstance(value, str) else float(value)
        except (QuantityError, TypeError, ValueError) as error:
            raise ParameterError(place, value, str(error)) from None

    spread = number(entry[width], unit if name in LINEAR else "-")
    spread = spread if name in LINEAR else float(np.log(max(spread, 1e-300)))
    if not 0.0 < spread < math.inf:
        raise ParameterError(f"{place}.{width}", entry[width], "must be above 0, a factor above 1")
    return number(entry[middle], unit), spread


def require_same_table(log: TestLog, scenario: Scenario) -> None:
    """Raise LogError where a log with a scenario is of another table, other sensors or another rate.

    What is estimated may differ; what a table is built of may not.
    """
    theirs = log.scenario
    require_same_test(theirs, scenario, log.name, but=("actuator", "nonlinearity", "delay", "specimen"))
    for name in ("piston_area", "oil_volume"):
        ours, other = getattr(scenario.actuator, name), getattr(theirs.actuator, name)
        if not math.isclose(ours, other, rel_tol=1e-6):
            raise LogError(
                f"{log.name}, actuator.{name}",
                other,
                f"the log is of another table: expected {ours}",
            )
    if theirs.specimen.stories != scenario.specimen.stories:
        ours, other = scenario.specimen.stories, theirs.specimen.stories
        raise LogError(f"{log.name}, storeys", other, f"the log is of another specimen: expected {ours}")
