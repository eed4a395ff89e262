"""Reads an HDF5 file for `hdf5.py`, as a process of its own: from standard input, to standard output.

The HDF5 library can loop for ever on a damaged file, or crash. Run by its path, with h5py and numpy
alone; it writes an ``.npz`` file: ``manifest``, JSON of what the file holds, and an array each data set.
Arguments: numbers of a data set at most, data sets at most, depth of groups, processor time [s].
"""

import io
import json
import sys
from typing import Any

import numpy as np

_MEMORY = 16 * 2**30  # [bytes] of addresses


def _plain(value: object) -> object:
    """Return an attribute as a text or a number."""
    if isinstance(value, bytes):
        return value.decode("utf-8", "replace")
    if isinstance(value, str):
        return value
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value)[:200]


def _limit(seconds: int) -> None:
    try:
        import resource
    except ImportError:  # not on every system; the parent's time limit holds
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> None:
    """Read and write."""
    import h5py  # which few have

    most, columns, deepest, seconds = map(int, sys.argv[1:5])
    _limit(seconds)
    items: list[dict[str, object]] = []
    arrays: dict[str, Any] = {}

    def walk(group: Any, prefix: str, depth: int) -> None:
        for key in group:
            if not prefix and key.startswith("#"):  # MATLAB's own
                continue
            entry: dict[str, object] = {"path": f"{prefix}{key}", "kind": "other", "attributes": {}}
            items.append(entry)
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                entry["kind"] = "link"
                continue
            item = group[key]
            if isinstance(item, h5py.Group):
                entry["kind"] = "group"
                if depth < deepest:
                    walk(item, f"{prefix}{key}/", depth + 1)
                continue
            if not isinstance(item, h5py.Dataset):
                continue
            entry["attributes"] = {str(k): _plain(v) for k, v in item.attrs.items()}
            if item.is_virtual or item.external:
                entry["kind"] = "elsewhere"
            elif item.dtype.kind not in "iufb":
                continue
            elif item.size is None or item.size > most or len(arrays) >= columns:
                entry["kind"], entry["size"] = "large", int(item.size or 0)
            else:
                entry["kind"], entry["array"] = "array", f"a{len(arrays)}"
                arrays[f"a{len(arrays)}"] = np.asarray(item[()])

    with h5py.File(io.BytesIO(sys.stdin.buffer.read()), "r") as file:
        attributes = {str(key): _plain(value) for key, value in file.attrs.items()}
        walk(file, "", 0)
    manifest = json.dumps({"attributes": attributes, "items": items})
    held = io.BytesIO()
    np.savez(held, manifest=np.frombuffer(manifest.encode(), dtype=np.uint8), **arrays)
    sys.stdout.buffer.write(held.getvalue())


if __name__ == "__main__":
    try:
        main()
    except Exception as error:  # what h5py raises on a damaged file is not written down
        sys.stderr.write(f"{type(error).__name__}: {error}"[:200])
        sys.exit(1)
