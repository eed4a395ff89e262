"""The command ``shake identify``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.markup import escape

from agents.cli.command_options import FolderOptions
from agents.progress import progress_by_name
from agents.reporting.terminal import print_table
from agents.scenario_options import ScenarioOptions
from shake_env.errors import ParameterError

CONVERGED = 1.05  # R-hat up to which walkers are taken to be of one distribution


@dataclass(frozen=True, kw_only=True)
class Identify(FolderOptions):
    """Identify table and specimen from logs of tests, with the uncertainty that is left.

    Writes posterior.json, which `[uncertainty.posterior]` of a scenario's file names, and figures of
    the measured frequency responses. Reads HDF5, MATLAB, TDMS and CSV; foreign files need a mapping.

    Try:
      shake identify logs/lqg_noise_1.h5
      shake identify shake1.h5 shake2.h5 --table table.toml --specimen specimen.toml
      shake identify daq.tdms --mapping daq.toml --scenario test.toml --band 0.2 40
      shake identify shake3.h5 --prior out/identify/posterior.json
    """

    logs: tyro.conf.Positional[tuple[Path, ...]]
    """Files of logs."""
    mapping: Path | None = None
    """TOML file that says what the columns of foreign files are."""
    scenario: str | None = None
    """Scenario or file of the test, for logs that hold none."""
    table: Path | None = None
    """File of the table as it was known before (default: as the log says)."""
    specimen: Path | None = None
    """File of the specimen as it was known before (default: as the log says)."""
    prior: Path | None = None
    """Prior: posterior.json of an earlier update, or a TOML file of medians and factors."""
    without: tuple[str, ...] = ()
    """Measured channels that are not used."""
    band: tuple[float, float] | None = None
    """Lowest and highest frequency that are fitted [Hz] (default: all)."""
    discrepancy: bool = True
    """Whether an error of the model is estimated, beside the sensors' noise."""
    sampler_seconds: float = 0.0
    """Time for the sampler [s]; 0 gives the normal posterior around the most probable values."""
    samples: int = 2000
    """Number of samples of the posterior."""
    seed: int = 0
    """Seed of everything drawn."""

    def run(self, console: Console) -> dict[str, Any]:
        """Read, fit, sample, print, write."""
        from agents.laboratory.identification.consistency import part_covered
        from agents.laboratory.identification.frequency_response import draw_frequency_responses
        from agents.laboratory.identification.identify import identify, model_of, read_prior
        from agents.laboratory.logs.log_file import read_log
        from agents.laboratory.logs.mapping import read_mapping

        if not self.logs:
            raise ParameterError("logs", None, "name at least one file")
        mapping = None if self.mapping is None else read_mapping(self.mapping)
        logs = [read_log(file, mapping) for file in self.logs]
        given = None if self.scenario is None else ScenarioOptions(self.scenario).build()
        scenario = model_of(logs, given, self.table, self.specimen)
        folder = self.results_folder("identify")
        with progress_by_name() as on_progress:
            result = identify(
                logs,
                scenario,
                prior=None if self.prior is None else read_prior(self.prior, scenario),
                without=self.without,
                band=self.band,
                discrepancy=self.discrepancy,
                samples=self.samples,
                sampler_seconds=self.sampler_seconds,
                seed=self.seed,
                on_progress=on_progress,
            )
        described = describe(result)
        print_identified(described, console)
        described["covered"] = [
            None if log.scenario_text is None else part_covered(log, log.scenario) for log in logs
        ]
        for log, covered in zip(logs, described["covered"], strict=True):
            if covered is not None:
                text = f"{log.name}: the log covers {covered[0]:.2f} of {covered[1]:.2f} s of its motion"
                console.print(escape(text), style="yellow", soft_wrap=True)
        if folder is not None:
            result.posterior.write(folder / "posterior.json")
            console.print(escape(f"wrote {folder / 'posterior.json'}"))
            for number, log in enumerate(logs, start=1):
                for path in draw_frequency_responses(log, folder, f"frequency_responses_{number}"):
                    console.print(escape(f"wrote {path}"))
        return described


def describe(result: Any) -> dict[str, Any]:
    """Return an identification as plain JSON values."""
    from agents.laboratory.identification.parameters import find_parameter, from_scale

    fit, posterior = result.fit, result.posterior
    intervals, prior = posterior.interval(), fit.prior
    middle = from_scale(prior.names, prior.mean)
    rows = []
    for i, name in enumerate(fit.names):
        low, high = intervals[name]
        rows.append(
            {
                "name": name,
                "unit": find_parameter(name).unit,
                "value": posterior.mean[name],
                "low": low,
                "high": high,
                "prior_median": float(middle[i]),
                "width_over_prior": float(fit.deviations[i] / prior.deviations[i]),
                "r_hat": None if posterior.r_hat is None else posterior.r_hat[i],
                "effective": None if posterior.effective is None else posterior.effective[i],
            }
        )
    explained = fit.likelihood.fit_of(fit.mode)
    return {
        "method": posterior.method,
        "seconds": fit.seconds,
        "parameters": rows,
        "unidentified": [str(each) for each in result.unidentified],
        "discrepancy": dict(posterior.shares),
        "explained": explained,
        "logs": [list(pair) for pair in posterior.logs],
    }


def print_identified(described: dict[str, Any], console: Console) -> None:
    """Print an identification for a person."""
    rows = []
    for row in described["parameters"]:
        cells = [row["name"], row["unit"], f"{row['prior_median']:.4g}", f"{row['value']:.5g}"]
        cells.append(f"{row['low']:.5g} to {row['high']:.5g}")
        cells.append(f"{100 * row['width_over_prior']:.0f} %")
        if row["r_hat"] is not None:
            cells += [f"{row['r_hat']:.3f}", f"{row['effective']:.0f}"]
        rows.append(cells)
    headings = ["parameter", "unit", "before", "value", "90 % interval", "width of\nprior's"]
    if described["parameters"][0]["r_hat"] is not None:
        headings += ["R-hat", "effective\nsamples"]
    print_table(console, headings, rows, names=2, left=(4,))
    for number, shares in enumerate(described["explained"], start=1):
        text = ", ".join(f"{name} {100 * share:.2f} %" for name, share in shares.items())
        console.print(f"log {number}, power explained: {text}", highlight=False, soft_wrap=True)
    lacking = {n: s for n, s in described["discrepancy"].items() if s > 0.0}
    if lacking:
        text = ", ".join(f"{name} {100 * share:.1f} %" for name, share in lacking.items())
        console.print(f"The model leaves out: {text} of the response.", highlight=False, soft_wrap=True)
    r_hats = [row["r_hat"] for row in described["parameters"] if row["r_hat"] is not None]
    if r_hats and not max(r_hats) <= CONVERGED:
        console.print(
            f"The sampler has not converged (largest R-hat {max(r_hats):.2f}, above {CONVERGED:g}): "
            "give more --sampler-seconds",
            style="yellow", highlight=False, soft_wrap=True,
        )  # fmt: skip
    for text in described["unidentified"]:
        console.print(
            f"Not identified by the logs: {text}", style="yellow", highlight=False, soft_wrap=True
        )
    console.print(f"{described['method']}, fit in {described['seconds']:.1f} s", highlight=False)
