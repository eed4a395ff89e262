"""Read and write the file of a log, in any of its formats."""

from __future__ import annotations

import os
from pathlib import Path

from agents.laboratory.logs.csv_file import csv_bytes, read_csv
from agents.laboratory.logs.hdf5_file import MAGIC, hdf5_bytes, read_hdf5
from agents.laboratory.logs.mapping import Mapped
from agents.laboratory.logs.matlab_file import matlab_bytes, read_matlab
from agents.laboratory.logs.raw import RawTable, assemble_log
from agents.laboratory.logs.tdms_file import read_tdms
from agents.laboratory.logs.test_log import TestLog
from shake_env.errors import LogError
from shake_env.files import no_file, write_bytes

WRITERS = {".h5": hdf5_bytes, ".hdf5": hdf5_bytes, ".mat": matlab_bytes, ".csv": csv_bytes}
LARGEST = 2_000_000_000  # bytes
_HDF5, _TDMS = b"\x89HDF\r\n\x1a\n", b"TDSm"
_MATLAB = (b"MATLAB 5.0 MAT-file", b"MATLAB 7.3 MAT-file")


def write_log(log: TestLog, file: str | os.PathLike[str]) -> None:
    """Write a log; the ending of the file's name (.h5, .hdf5, .mat, .csv) decides its format.

    Raises
    ------
    LogError
        If the ending is another, or a library is missing.
    FileError
        If the file cannot be written.
    """
    file = Path(file)
    if file.suffix not in WRITERS:
        raise LogError("file", str(file), f"must end in {', '.join(WRITERS)}")
    write_bytes(file, WRITERS[file.suffix](log))


def read_log(file: str | os.PathLike[str], mapping: Mapped | None = None) -> TestLog:
    """Return the log of a file: HDF5, MATLAB 5 or 7.3, TDMS, or CSV, told by its first bytes.

    Parameters
    ----------
    file
        The file.
    mapping
        What the columns of a foreign file are (`mapping.read_mapping`); None: the file is a log that
        this program wrote.

    Raises
    ------
    LogError
        If it cannot be read, is damaged, or is no log.
    RecordError
        If a MATLAB file is damaged.
    """
    file = Path(file)
    if not file.is_file():
        raise LogError("log", str(file), no_file(file))
    try:
        if file.stat().st_size > LARGEST:
            raise LogError("log", str(file), f"is larger than {LARGEST // 10**9} GB")
        content = file.read_bytes()
    except OSError as error:
        raise LogError("log", str(file), f"cannot be read ({error.strerror})") from None
    return parse_log(str(file), content, mapping)


def parse_log(source: str, content: bytes, mapping: Mapped | None = None) -> TestLog:
    """Return the log of a file whose bytes are in memory; see :func:`read_log`."""
    return assemble_log(_raw(source, content, mapping), Path(source).stem, mapping)


def _raw(source: str, content: bytes, mapping: Mapped | None) -> RawTable:
    if content.startswith(_MATLAB):
        return read_matlab(source, content)
    if content.startswith((_HDF5, MAGIC)):
        return read_hdf5(source, content)
    if content.startswith(_TDMS):
        return read_tdms(source, content)
    if b"\0" in content[:4096] or not content.strip():
        raise LogError("log", source, "is no HDF5, MATLAB, TDMS or CSV file")
    return read_csv(source, content, None if mapping is None else mapping.delimiter)
