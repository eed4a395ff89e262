"""Logs as MATLAB's ``.mat``: version 5 is written and read; 7.3, which is HDF5, is read by h5py.

A channel is a variable of its name. Texts are bytes (``uint8``), so that a scenario's file of any length
passes: ``char(texts.scenario)`` shows it.
"""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from scipy.io import savemat

from agents.laboratory.logs.raw import RawTable, attributes_of, column_unit
from agents.laboratory.logs.test_log import MOST, TestLog
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray
from shake_env.records.formats.matlab import matlab_variables

_TEXTS = "texts"  # structure of the attributes that are texts


def matlab_bytes(log: TestLog) -> bytes:
    """Return the file of a log, MATLAB 5, compressed."""
    stated = attributes_of(log)
    texts = {key: _bytes(value) for key, value in stated.items() if isinstance(value, str)}
    numbers = {key: float(value) for key, value in stated.items() if not isinstance(value, str)}
    units = {name: _bytes(column_unit(log, name)) for name in log.channels}
    variables: dict[str, Any] = {name: values[:, None] for name, values in log.channels.items()}
    held = io.BytesIO()
    savemat(held, {**variables, "units": units, _TEXTS: texts, **numbers}, do_compression=True)
    return held.getvalue()


def read_matlab(source: str, content: bytes) -> RawTable:
    """Return the columns of a file.

    Raises
    ------
    RecordError
        If it is damaged, or 7.3 and h5py is missing.
    LogError
        If a text is none.
    """
    variables = dict(matlab_variables(source, content))
    columns: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    attributes: dict[str, str | float] = {}
    for key, value in variables.items():
        if isinstance(value, str):
            attributes[key] = value
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "iuf":
            continue
        flat = np.asarray(value, dtype=np.float64).ravel()
        group, _, name = key.rpartition(".")
        if group in ("units", _TEXTS):
            (units if group == "units" else attributes)[name] = _text(flat, f"{source}, {key}")
        elif flat.size == 1:
            attributes[key] = float(flat[0])
        elif value.ndim == 1 or 1 in value.shape:
            if flat.size > MOST:
                raise LogError(f"{source}, {key}", flat.size, f"at most {MOST} samples are read")
            columns[key] = flat
    kind = "MATLAB 5" if content.startswith(b"MATLAB 5.0") else "MATLAB 7.3"
    return RawTable(f"{source} ({kind})", columns, units, attributes)


def _bytes(text: str) -> Any:
    return np.frombuffer(text.encode(), dtype=np.uint8)[None]


def _text(codes: FloatArray, place: str) -> str:
    if not np.all((codes >= 0.0) & (codes < 256.0)):
        raise LogError(place, codes[:8].tolist(), "must be bytes of a text")
    return codes.astype(np.uint8).tobytes().decode("utf-8", "replace")
