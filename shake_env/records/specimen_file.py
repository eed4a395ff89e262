"""Structures from files of their matrices: MAT files through the project's own reader, and CSV."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from shake_env.errors import FileError, RecordError
from shake_env.model.parameters import Specimen
from shake_env.model.specimens import specimen_from_matrices
from shake_env.records.formats.matlab import is_matlab, matlab_variables
from shake_env.records.motion_file import file_content
from shake_env.records.text.source import parse_number

_MATRICES = ("M", "K", "C")


def read_specimen(file: str | os.PathLike[str], **damping: Any) -> Specimen:
    """Return the structure of a MAT or CSV file that holds M, K and perhaps C.

    A MAT file (version 5 to 7; 7.3 with h5py) has variables of these names, of either case. In a CSV
    file each matrix follows a line with its name alone, one row a line; ``#`` begins a remark.

    Parameters
    ----------
    file
        Path of a regular file.
    damping
        `damping_ratio` or `rayleigh` of `specimen_from_matrices`, where the file has no C.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, or has no M or K.
    ParameterError
        If the matrices are no structure's.
    """
    path = Path(file)
    try:
        data = file_content(path)
        if path.suffix.lower() == ".mat" or is_matlab(data):
            matrices = _mat(path.name, data)
        else:
            matrices = _csv(data)
    except RecordError as error:
        raise FileError("specimen file", str(path), f"cannot be read: {error}") from None
    except ValueError as error:
        raise FileError("specimen file", str(path), f"cannot be read: {error}") from None
    for name in ("M", "K"):
        if name not in matrices:
            raise FileError("specimen file", str(path), f"has no matrix {name}")
    return specimen_from_matrices(matrices["M"], matrices["K"], matrices.get("C"), **damping)


def _mat(name: str, data: bytes) -> Mapping[str, Any]:
    variables = {key.upper(): value for key, value in matlab_variables(name, data).items()}
    return {key: variables[key] for key in _MATRICES if key in variables}


def _csv(data: bytes) -> Mapping[str, Any]:
    matrices: dict[str, list[list[float]]] = {}
    rows: list[list[float]] | None = None
    for line_number, line in enumerate(data.decode("utf-8-sig").splitlines(), start=1):
        text = line.partition("#")[0].replace(";", ",").strip().strip(",")
        if not text:
            continue
        if text.upper() in _MATRICES:
            rows = matrices.setdefault(text.upper(), [])
        elif rows is None:
            raise ValueError(f"line {line_number} stands before the name of a matrix: M, K or C")
        else:
            values = [parse_number(part) for part in text.replace(",", " ").split()]
            if None in values:
                raise ValueError(f"line {line_number} is no row of finite numbers")
            rows.append([value for value in values if value is not None])
    return matrices
