"""Errors that a caller can catch by type and a reader can act on.

Every message has the same three parts: the field, the value found there, and the remedy.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class ShakeError(ValueError):
    """Base of every error this package raises on purpose.

    Parameters
    ----------
    field
        Name of the parameter, file or array at fault.
    value
        What was found there.
    remedy
        What would be accepted, or what to do.
    """

    def __init__(self, field: str, value: object, remedy: str) -> None:
        self.field, self.value, self.remedy = field, value, remedy
        super().__init__(f"{field} = {_shown(value)}: {remedy}")

    def __reduce__(self) -> tuple[type[ShakeError], tuple[str, object, str]]:
        # BaseException pickles by self.args, which holds one message and not these three parts;
        # worker processes send errors home by pickle.
        return type(self), (self.field, self.value, self.remedy)


def _shown(value: object) -> str:
    try:
        return repr(value)
    except Exception:  # a number of over 4300 digits, or whatever the __repr__ of an object raises
        return f"<{type(value).__name__}>"


class ParameterError(ShakeError):
    """A physical parameter or an option is outside its allowed range."""


class ScenarioError(ShakeError):
    """A scenario is unknown, or its parts do not fit together."""


class ActionError(ShakeError):
    """An action has the wrong shape, or is not a number."""


class RecordError(ShakeError):
    """A recorded motion is unknown, or its file contradicts itself."""


class LogError(ShakeError):
    """A log of a test is incomplete, contradicts itself, or is of another table or motion."""


class PolicyFileError(ShakeError):
    """A policy file is missing, truncated, corrupt, or made for another observation."""


class RunDirectoryError(ShakeError):
    """A training run's directory exists already, or holds nothing to resume."""


class FileError(ShakeError):
    """A file or folder cannot be read or written, or does not hold what it should."""


class NumericalError(ShakeError):
    """A Riccati, Lyapunov or discretisation result failed its own check."""


def install_hint(extra: str) -> str:
    """Return how to install an extra of this project, which no package index has."""
    return f"in the folder of the project's source: python -m pip install '.[{extra}]'"


def unknown(kind: type[ShakeError], field: str, value: str, known: Iterable[str]) -> ShakeError:
    """Return an error of type `kind` for a name that is not among the `known` ones."""
    names = sorted(known)
    near = get_close_matches(value, names, n=1)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return kind(field, value, f"{hint}known: {', '.join(names)}")
