"""The datagram between a table and its controller; the C program for UDP follows the same numbers.

Little-endian, without padding:

====== ====== ==========================================================================
bytes  type   what
====== ====== ==========================================================================
0-3    char   ``SHK1``
4      uint8  kind: 1 measurement (to the controller), 2 command (to the table)
5      uint8  version of the layout: 1
6-7    uint16 flags: 1 a test begins, 2 the controller refused the measurement, 4 the end; of a
              command the upper byte counts the datagrams of the test that were not answered
8-11   uint32 sequence number: control period since the test's start
12-19  double time since the test's start [s]; a command repeats its measurement's
20-21  uint16 number n of channels
22-23  uint16 number of the test, another one than that of the test before
24-    double channels in SI, n of them, in the order of the program's header
24+8n  uint32 CRC-32 (IEEE 802.3, as zlib computes it) of everything before
====== ====== ==========================================================================
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from shake_env.model.parameters import FloatArray

MAGIC, VERSION = b"SHK1", 1
MEASUREMENT, COMMAND = 1, 2
BEGINS, REFUSED, ENDS = 1, 2, 4
IGNORED_SHIFT = 8  # bits, of the count in a command's flags
HEADER = struct.Struct("<4sBBHIdHH")
CHECK = struct.Struct("<I")
LARGEST = 1400  # bytes; what one Ethernet frame carries


@dataclass(frozen=True)
class Datagram:
    """One measurement or command."""

    kind: int
    sequence: int
    time: float  # [s]
    channels: FloatArray  # (n,) SI
    flags: int = 0
    test: int = 0

    def pack(self) -> bytes:
        """Return the bytes to send."""
        count = len(self.channels)
        head = HEADER.pack(
            MAGIC, self.kind, VERSION, self.flags, self.sequence, self.time, count, self.test & 0xFFFF
        )
        body = head + np.ascontiguousarray(self.channels, dtype="<f8").tobytes()
        return body + CHECK.pack(zlib.crc32(body))


def unpack(data: bytes) -> Datagram | None:
    """Return a datagram, or None where the bytes are none: length, magic, version or CRC are wrong."""
    if len(data) < HEADER.size + CHECK.size or data[:4] != MAGIC:
        return None
    _, kind, version, flags, sequence, time, count, test = HEADER.unpack_from(data)
    end = HEADER.size + 8 * count
    if version != VERSION or len(data) != end + CHECK.size:
        return None
    if CHECK.unpack_from(data, end)[0] != zlib.crc32(data[:end]):
        return None
    channels = np.frombuffer(data, dtype="<f8", count=count, offset=HEADER.size).astype(float)
    return Datagram(kind, sequence, time, channels, flags, test)


def c_numbers() -> dict[str, Any]:
    """Return the layout as the template of the C program for UDP takes it."""
    return {
        "magic": MAGIC.decode(), "version": VERSION, "measurement": MEASUREMENT, "command": COMMAND,
        "begins": BEGINS, "refused": REFUSED, "ends": ENDS, "header": HEADER.size,
    }  # fmt: skip
