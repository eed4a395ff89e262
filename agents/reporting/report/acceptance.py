"""The section of a report that holds the table's acceleration against a required response spectrum."""

from __future__ import annotations

from dataclasses import dataclass

from matplotlib.figure import Figure

from agents.acceptance.required import RequiredSpectrum
from agents.reporting.figures.acceptance import acceptance_figure
from agents.reporting.report.contents import Report


@dataclass(frozen=True)
class Row:
    """One controller over the earthquakes of the verdict."""

    label: str
    passed: int
    tests: int  # those in which the table moved
    lowest: float  # least TRS over RRS of all ordinates and tests [-]
    frequency: float  # at which it is [Hz]
    failed: tuple[str, ...]  # clauses, each with the number of tests that do not meet it


@dataclass(frozen=True)
class AcceptanceSection:
    """The required spectrum, each controller's row, and the spectra of one earthquake."""

    required: RequiredSpectrum
    earthquake: str  # that the figure shows
    figure: Figure
    rows: tuple[Row, ...]


def acceptance_section(report: Report) -> AcceptanceSection | None:
    """Return the report's section on a required spectrum; None where none was named, or no table moved.

    The earthquakes are those of the verdict; the figure shows the first.
    """
    gathered, members = report.gathered, report.members
    required = gathered.required
    if required is None:
        return None
    rows, spectra = [], {}
    first = None
    for name, label in report.labels.items():
        results = [gathered.acceptances[name][i] for i in members]
        moved = [result for result in results if result is not None]
        if not moved:
            continue
        if results[0] is not None:
            first = first or results[0]
            spectra[label] = results[0].trs[0]
        ratios = [result.trs[0] / result.rrs for result in moved]
        least = min(ratios, key=min)
        failed: dict[str, int] = {}
        for result in moved:
            for clause in result.clauses:
                if not clause.passed:
                    words = clause.name.removeprefix(f"{result.names[0]}: ")
                    failed[words] = failed.get(words, 0) + 1
        rows.append(
            Row(
                label=label,
                passed=sum(result.passed for result in moved),
                tests=len(moved),
                lowest=float(least.min()),
                frequency=float(moved[0].frequency[least.argmin()]),
                failed=tuple(f"{words} ({count})" for words, count in failed.items()),
            )
        )
    if first is None:
        return None
    earthquake = gathered.earthquakes[members[0]].name
    figure = acceptance_figure(first, spectra, f"{required.name}: {earthquake}")
    return AcceptanceSection(required, earthquake, figure, tuple(rows))
