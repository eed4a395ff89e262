"""Files of records damaged at random: the right data or an error, never wrong data."""

import random
import time

import numpy as np
import pytest
from format_texts import FORMATS
from record_texts import AT2, CSV, KNET, V1, V2, at2_text, wave

from shake_env.errors import RecordError
from shake_env.records import parse_motion


def embedded_text(points=30):
    lines = {
        "event": "e", "station": "s", "component": "c", "network": "n", "licence": "l",
        "sampling_interval_s": "0.005", "points": str(points), "units": "g",
    }  # fmt: skip
    head = "".join(f"# {key}: {value}\n" for key, value in lines.items())
    return head + "acceleration\n" + "".join(f"{v:.6f}\n" for v in wave(points))


BASES = {
    "at2": AT2,
    "at2 new": at2_text(wave(31), "0.0100", header="{n:5d}    {step}    NPTS, DT"),
    "v1": V1,
    "v2": V2,
    "knet": KNET,
    "csv": CSV,
    "csv counted": "# points: 20\n" + CSV,
    "embedded": embedded_text(),
    **FORMATS,
}
# Said once, by the times, or a second time with few digits.
STEP_IS_FREE = {"at2", "at2 new", "csv", "csv counted", "embedded", *FORMATS}
OTHER_BLOCKS = {"v2", "cosmos", "geonet 1", "geonet 2", "cdmg 2"}  # velocities, numbers of the header


KINDS = ("cut", "flip", "flip", "delete line", "repeat line", "swap lines", "insert", "remove",
         "edit number", "edit number")  # fmt: skip


class Damage:
    """One damaged file: what was done to it, and how many samples that may have changed."""

    def __init__(self, rng, data):
        self.kind = rng.choice(KINDS)
        self.touched = 0
        getattr(self, self.kind.replace(" ", "_"))(rng, data)

    def cut(self, rng, data):
        end = len(data) - rng.randrange(1, 12) if rng.random() < 0.3 else rng.randrange(len(data))
        self.data = data[:end]

    def flip(self, rng, data):
        changed = bytearray(data)
        for _ in range(rng.choice([1, 1, 2, 4])):
            changed[rng.randrange(len(data))] = rng.choice([rng.randrange(256), *b"0123456789 -.,E\n"])
            self.touched += 1
        self.data = bytes(changed)

    def _lines(self, rng, data):
        lines = data.split(b"\n")
        return lines, rng.randrange(len(lines) - 1)

    def delete_line(self, rng, data):
        lines, at = self._lines(rng, data)
        self.data = b"\n".join(lines[:at] + lines[at + 1 :])

    def repeat_line(self, rng, data):
        lines, at = self._lines(rng, data)
        self.data = b"\n".join(lines[: at + 1] + lines[at:])

    def swap_lines(self, rng, data):
        lines, at = self._lines(rng, data)
        other = rng.randrange(len(lines) - 1)
        lines[at], lines[other] = lines[other], lines[at]
        self.touched = 20  # two lines of ten
        self.data = b"\n".join(lines)

    def insert(self, rng, data):
        at = rng.randrange(len(data))
        piece = bytes(rng.choice(b"0123456789 -.,E\n\0\xff") for _ in range(rng.choice([1, 1, 3, 9])))
        self.touched = 10
        self.data = data[:at] + piece + data[at:]

    def remove(self, rng, data):
        at = rng.randrange(len(data))
        self.touched = 10
        self.data = data[:at] + data[at + rng.choice([1, 1, 2, 9, 80]) :]

    def edit_number(self, rng, data):
        places = [
            i for i in range(len(data)) if data[i : i + 1].isdigit() and not data[i - 1 : i].isdigit()
        ]
        at = rng.choice(places[: max(12, len(places) // 8)] if rng.random() < 0.7 else places)
        end = at
        while data[end : end + 1].isdigit():
            end += 1
        old = int(data[at:end])
        new = rng.choice(
            [old + 1, max(old - 1, 0), old * 10, 0, 10**30, -old, "nan", "inf", "", "1e9", "8f9.6"]
        )
        self.touched = 1
        self.data = data[:at] + str(new).encode() + data[end:]


def judge(name, base, damage, records):
    """Raise AssertionError where what came out of a damaged file is neither right nor legal."""
    counted = name != "csv"
    assert all(r.sampling_interval > 0 and np.isfinite(r.acceleration).all() for r in records)
    if not counted:
        # No header says how many rows there are: a file that lost its last or first ones is legal.
        assert len(records) == 1
        if damage.kind in ("cut", "delete line", "remove"):
            whole, found = base[0].acceleration, records[0].acceleration
            lost = len(whole) - len(found)
            ends_lost = np.array_equal(found, whole[: len(found)]) or np.array_equal(found, whole[lost:])
            assert ends_lost or (lost >= 0 and damage.kind == "remove")
        return
    assert len(records) == len(base), "a channel was lost or won"
    # A line of another block, of velocities, is as legal there: such are left to the count below.
    if damage.kind == "swap lines" and name not in OTHER_BLOCKS:
        both = [np.sort(np.concatenate([r.acceleration for r in some])) for some in (records, base)]
        assert np.array_equal(*both)
        return
    changed = 0
    for found, right in zip(records, base, strict=True):
        assert len(found.acceleration) == len(right.acceleration), "samples were lost or won"
        if name not in STEP_IS_FREE:
            assert found.sampling_interval == pytest.approx(right.sampling_interval, rel=1e-6)
        differing = found.acceleration != right.acceleration
        if differing.all():  # a scale factor, within what the header's peak allows
            ratio = found.acceleration / right.acceleration
            assert np.ptp(ratio) < 1e-9 and abs(ratio[0] - 1.0) < 0.03, "another scale"
        else:
            changed += int(differing.sum())
    if damage.kind in ("cut", "delete line", "repeat line"):
        assert changed == 0
    assert changed <= damage.touched


def fuzz(number, seed):
    bases = {name: (text.encode(), parse_motion(name, text.encode())) for name, text in BASES.items()}
    rng = random.Random(seed)
    refused = 0
    slowest = 0.0
    for _ in range(number):
        name = rng.choice(list(bases))
        data, right = bases[name]
        damage = Damage(rng, data)
        began = time.perf_counter()
        try:
            records = parse_motion(name, damage.data)
        except RecordError as error:
            assert error.field.startswith(name) and error.remedy
            refused += 1
        else:
            try:
                judge(name, right, damage, records)
            except AssertionError as wrong:
                raise AssertionError(f"{name}, {damage.kind}: {wrong}\n{damage.data!r}") from wrong
        slowest = max(slowest, time.perf_counter() - began)
    return refused, slowest


def test_2_000_damaged_files_give_the_right_data_or_a_record_error():
    refused, slowest = fuzz(2_000, seed=0)
    assert 1_000 < refused < 1_990
    assert slowest < 5.0


@pytest.mark.slow
def test_100_000_damaged_files_give_the_right_data_or_a_record_error():
    began = time.perf_counter()
    refused, slowest = fuzz(100_000, seed=1)
    print(
        f"{refused} of 100000 refused, slowest {slowest:.3f} s, "
        f"{time.perf_counter() - began:.0f} s in all"
    )
    assert slowest < 5.0


def test_every_cut_of_a_counted_file_is_refused_or_leaves_the_data_whole():
    for name, text in BASES.items():
        if name == "csv":
            continue
        data = text.encode()
        right = parse_motion(name, data)
        few = 61 if name in FORMATS else 7
        for end in range(0, len(data), 1 if name in ("at2", "embedded") else few):
            try:
                records = parse_motion(name, data[:end])
            except RecordError:
                continue
            assert [r.acceleration.tobytes() for r in records] == [
                r.acceleration.tobytes() for r in right
            ]
