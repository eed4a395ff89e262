"""Recorded components that come with the package, and readers of files of motions and structures.

The six are public-domain (CC0) records distributed by CESMD, which asks for attribution: keep it with
the data.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

from shake_env.errors import RecordError, unknown
from shake_env.records.formats.embedded import parse_record, write_record
from shake_env.records.motion_file import file_content, parse_motion, read_motion
from shake_env.records.record import Record
from shake_env.records.specimen_file import read_specimen

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
    return parse_record(name, resources.files(__package__).joinpath(f"{name}.csv").read_bytes())


__all__ = [
    "RECORD_NAMES",
    "Record",
    "file_content",
    "load_record",
    "parse_motion",
    "parse_record",
    "read_motion",
    "read_specimen",
    "write_record",
]
