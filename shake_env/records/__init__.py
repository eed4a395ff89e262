"""Six recorded horizontal components that come with the package, with their attribution.

Public-domain (CC0) records distributed by CESMD, which asks for attribution: keep it with the data.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

from shake_env.errors import RecordError, unknown
from shake_env.records.reader import Record, parse_record

RECORD_NAMES = (
    "napa2014_68150_hne",
    "napa2014_68150_hnn",
    "ridgecrest2019_ccc_360",
    "ridgecrest2019_ccc_90",
    "ridgecrest2019_clc_360",
    "ridgecrest2019_clc_90",
)


@cache
def load_record(name: str) -> Record:
    """Return the embedded record called `name` (one of ``RECORD_NAMES``).

    Raises
    ------
    RecordError
        If there is no such record.
    """
    if name not in RECORD_NAMES:
        raise unknown(RecordError, "record", name, RECORD_NAMES)
    text = resources.files(__package__).joinpath(f"{name}.csv").read_text(encoding="utf-8")
    return parse_record(name, text)


__all__ = ["RECORD_NAMES", "Record", "load_record", "parse_record"]
