"""Logs that LabVIEW wrote as TDMS: read by npTDMS. A column is a channel, titled ``group/channel``.

Units are the property ``unit_string``, the step is ``wf_increment``; properties of the file that have
the names of a log's attributes are those.
"""

from __future__ import annotations

import io
import logging
import warnings

import numpy as np

from agents.laboratory.logs.hdf5_file import import_library
from agents.laboratory.logs.raw import RawTable, text_value, typed
from agents.laboratory.logs.test_log import MOST
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray


def read_tdms(source: str, content: bytes) -> RawTable:
    """Return the columns of a file.

    Raises
    ------
    LogError
        If npTDMS is missing or cannot read it, or channels state several steps.
    """
    nptdms = import_library("nptdms")
    logging.getLogger("nptdms").setLevel(logging.CRITICAL)  # it prints what it could not read
    columns: dict[str, FloatArray] = {}
    units: dict[str, str] = {}
    steps: set[float] = set()
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            file = nptdms.TdmsFile.read(io.BytesIO(content))
            attributes = {str(key): text_value(value) for key, value in file.properties.items()}
            groups = file.groups()
            for group in groups:
                for channel in group.channels():
                    if len(channel) > MOST:
                        raise LogError(source, len(channel), f"at most {MOST} samples are read")
                    values = np.asarray(channel[:])
                    if values.dtype.kind not in "iuf" or values.ndim != 1:
                        continue
                    title = f"{group.name}/{channel.name}"
                    columns[title] = values.astype(np.float64)
                    if "unit_string" in channel.properties:
                        units[title] = str(channel.properties["unit_string"])
                    if "wf_increment" in channel.properties:
                        steps.add(float(channel.properties["wf_increment"]))
    except (Exception, MemoryError) as error:  # npTDMS trusts the sizes that a file states
        raise typed(error, source, "npTDMS cannot read it: the file is damaged") from None
    if len(steps) > 1:
        raise LogError(f"{source}, wf_increment", sorted(steps), "all channels must have one step")
    if steps and "sampling_interval" not in attributes:
        attributes["sampling_interval"] = steps.pop()
    prefix = "channels/"
    if attributes.get("format") is not None:
        columns = {title.removeprefix(prefix): values for title, values in columns.items()}
        units = {title.removeprefix(prefix): unit for title, unit in units.items()}
    return RawTable(f"{source} (TDMS)", columns, units, attributes)
