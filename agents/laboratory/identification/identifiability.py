"""Which parameters a log cannot tell, and the excitation that would."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from agents.laboratory.identification.fit import Fit
from agents.laboratory.identification.parameters import parameter

FLAT = 0.7  # of the prior's standard deviation: a posterior so wide was not told by the log
TIED = 0.95  # correlation above which two parameters cannot be told apart


@dataclass(frozen=True)
class Untold:
    """A parameter that logs do not tell, or two that they do not tell apart."""

    names: tuple[str, ...]
    reason: str
    excitation: str  # what would tell

    def __str__(self) -> str:
        return f"{' and '.join(self.names)}: {self.reason}; what would tell: {self.excitation}"


def untold(fit: Fit) -> list[Untold]:
    """Return what the logs of a fit cannot tell."""
    untold_parameters = []
    shares = fit.deviations / fit.prior.deviations
    for name, share in zip(fit.names, shares, strict=True):
        if share > FLAT:
            reason = f"the posterior is {100 * share:.0f} % as wide as the prior"
            untold_parameters.append(Untold((name,), reason, parameter(name).excitation))
    correlation = fit.correlation
    for i, j in np.argwhere(np.triu(np.abs(correlation) > TIED, k=1)).tolist():
        names = (fit.names[i], fit.names[j])
        reason = f"their correlation is {correlation[i, j]:.3f}"
        ways = dict.fromkeys(parameter(name).excitation for name in names)
        untold_parameters.append(Untold(names, reason, "; ".join(ways)))
    return untold_parameters
