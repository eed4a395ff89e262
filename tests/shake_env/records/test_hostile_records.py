"""Texts and files made to hang, or to fill the memory: linear time and a small multiple of memory."""

import importlib
import os
import pkgutil
import random
import re
import threading
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from record_texts import AT2, CSV, KNET, V1, V2, at2_text, csv_text, knet_text, v1_channel, wave

import shake_env.records
from shake_env.errors import ParameterError, RecordError
from shake_env.records import Record, load_record, parse_motion, read_motion, write_record
from shake_env.records.units import unit_asked

SECONDS_PER_BYTE = 2e-5
SECONDS_BESIDE = 0.1  # for a text of few bytes
PIECES = [
    *" \t\x00109.-+eE,;()[]#\"'=:/\n\ra\x1a\xb2",
    *("9.", "1e", ", ", "( ", "[ ]", "# ", "\r\n", "a b ", "in ", "unit ", "units of ", "at ", "chan "),
    *("max = ", "(1 ", "1 points of ", "NPTS", "NPTS= 1", "DT=", "sec", "acc (", "acceleration,"),
    *("/&", "record length = ", "0,1;", "1 2\n", "0,5\n"),
]
BASES = (AT2, V1, V2, KNET, CSV, "# units: g\n" + CSV, "400 0.01\n" + "0.1\n" * 400)


def seconds_for(text, **options):
    data = text.encode("latin-1", "replace")
    began = time.process_time()
    try:
        parse_motion("made", data, **options)
    except RecordError as error:
        assert len(str(error)) < 2_000
    return time.process_time() - began, len(data)


def check_time(text, **options):
    taken, size = seconds_for(text, **options)
    if (
        taken > SECONDS_BESIDE + SECONDS_PER_BYTE * size
    ):  # once more: another process may have been at work
        taken, size = seconds_for(text, **options)
    assert taken <= SECONDS_BESIDE + SECONDS_PER_BYTE * size, (
        f"{taken:.2f} s for {size} bytes: {text[:80]!r}"
    )


MANY = 20_000
HANGING = {
    "blanks in a bracket": "acc (" + " " * 1_000 + "x\n0 1\n1 2\n",
    "many brackets": "time," + "acc (" * 4_000 + " " * 4_000 + "x\n0,1\n1,2\n",
    "many digits": "1" * MANY + "\n1\n2\n",
    "many digits and a letter": "1" * MANY + "x\n",
    "many columns": "1," * MANY + "x\n1,2\n",
    "at2 count": AT2.replace("NPTS=", "NPTS=" + "1" * MANY, 1),
    "at2 step": AT2.replace("DT=", "DT=" + " " * MANY + "x", 1),
    "csmip channel": V1.replace("Chan  1:", "Chan  1:" + " " * MANY + "x", 1),
    "csmip channels": V1.replace("3 Chns", "( " * (MANY // 2) + "3" * MANY + " Chns", 1),
    "csmip length": V1.replace("Record Length =", "Record Length =" + "1" * MANY + "x", 1),
    "csmip rate": V1.replace("Samples/sec", "1" * MANY + "x", 1),
    "csmip count": V1.replace("21 Accel", "1" * MANY + " accel", 1),
    "knet scale": KNET.replace("3920(gal)", "1" * MANY + "x(gal)", 1),
    "knet rate": KNET.replace("100Hz", "1" * MANY + "Hx", 1),
}


@pytest.mark.parametrize("case", HANGING)
def test_texts_that_hung_the_readers_are_refused_at_once(case):
    check_time(HANGING[case])


def hostile_text(rng):
    text = rng.choice(BASES)
    for _ in range(rng.choice([1, 1, 2, 3])):
        run = rng.choice(PIECES) * (rng.choice([30, 1_000, 8_000]) // rng.choice([1, 1, 4]))
        at = rng.randrange(min(len(text), 600))
        text = text[:at] + run + (rng.choice(PIECES) if rng.random() < 0.5 else "") + text[at:]
    return text


def fuzz(number, seed):
    rng = random.Random(seed)
    for _ in range(number):
        check_time(hostile_text(rng), **rng.choice([{}, {"units": "g", "sampling_interval": 0.01}]))


def test_hostile_texts_take_a_limited_time_per_byte():
    fuzz(200, seed=0)


@pytest.mark.slow
def test_many_hostile_texts_take_a_limited_time_per_byte():
    fuzz(5_000, seed=1)


def patterns():
    """Yield the compiled patterns of all modules of the readers, each once."""
    yielded = set()
    for module_info in pkgutil.walk_packages(shake_env.records.__path__, "shake_env.records."):
        module = importlib.import_module(module_info.name)
        for name, value in vars(module).items():
            for pattern in value if isinstance(value, tuple) else (value,):
                if isinstance(pattern, re.Pattern) and pattern not in yielded:
                    yielded.add(pattern)
                    short = module_info.name.removeprefix("shake_env.records.")
                    yield pytest.param(pattern, id=f"{short}.{name}")


PATTERNS = list(patterns())


def flat(parsed):
    """Yield the parts of a pattern, those in groups as if they stood alone."""
    for operation, value in parsed:
        if str(operation) == "SUBPATTERN":
            yield from flat(value[3])
        else:
            yield operation, value


def backtracking(parsed, repeated=False):
    """Return whether a pattern has two repeated parts side by side, or one inside another.

    Possessive ones do not count, for they give nothing back; nor do those of a few times at most.
    """
    before = False
    for operation, value in flat(parsed):
        name = str(operation)
        if name in ("MAX_REPEAT", "MIN_REPEAT"):
            many = value[1] > 9
            if backtracking(value[2], repeated or many) or (many and (before or repeated)):
                return True
            before = many or (before and value[0] == 0)
            continue
        parts = value[1] if name == "BRANCH" else [value[2]] if name == "POSSESSIVE_REPEAT" else []
        if any(backtracking(part, repeated) for part in parts):
            return True
        before = before and name == "AT"
    return False


@pytest.mark.parametrize("pattern", PATTERNS)
def test_no_pattern_of_the_readers_has_adjacent_quantifiers(pattern):
    assert not backtracking(re._parser.parse(pattern.pattern, pattern.flags))


def test_the_patterns_of_every_room_of_the_readers_are_checked():
    compiling = {
        ".".join(path.relative_to(path.parents[1]).with_suffix("").parts)
        for path in Path(shake_env.records.__path__[0]).glob("*/*.py")
        if "re.compile(" in path.read_text(encoding="utf-8")
    }
    checked = {parameter.id.rpartition(".")[0] for parameter in PATTERNS}
    assert {"formats.peer", "text.titles"} <= compiling <= checked


def test_the_check_of_patterns_finds_adjacent_quantifiers():
    for pattern in (r"\d+\.?\d*", r"\s*x?\s+", r"(a+)+", r"\s*(.*?)\s*"):
        assert backtracking(re._parser.parse(pattern))
    assert not backtracking(re._parser.parse(r"\s*+\d++x?\s*"))


def test_a_line_without_end_is_refused():
    with pytest.raises(RecordError, match="65536 bytes"):
        parse_motion("made", b"0.1 " * 40_000, units="g")


# --- the door ------------------------------------------------------------------------------------


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="the system has no FIFO")
def test_a_fifo_is_refused_without_waiting_for_a_writer(tmp_path):
    fifo = tmp_path / "motion.csv"
    os.mkfifo(fifo)
    caught = []

    def read():
        try:
            read_motion(fifo)
        except RecordError as error:
            caught.append(error)

    thread = threading.Thread(target=read, daemon=True)
    thread.start()
    thread.join(5.0)
    assert caught and "regular file" in str(caught[0])


@pytest.mark.parametrize("path", ["/dev/zero", "/dev/null", "/dev/tty", "."])
def test_what_is_no_regular_file_is_refused(path):
    if not os.path.exists(path):
        # Containers and other systems than Linux lack some of the devices: there is nothing to refuse.
        pytest.skip("the system has no such file")
    with pytest.raises(RecordError, match="regular file"):
        read_motion(path)


def test_a_huge_file_is_refused_by_its_size(tmp_path):
    path = tmp_path / "huge.csv"
    with path.open("wb") as stream:
        stream.truncate(1 << 40)
    with pytest.raises(RecordError, match="268435456"):
        read_motion(path)


def test_paths_are_str_or_os_pathlike(tmp_path):
    class Named:
        def __fspath__(self):
            return str(tmp_path / "made.csv")

    record = load_record("napa2014_68150_hne")
    write_record(record, Named())
    for path in (Named(), str(tmp_path / "made.csv"), tmp_path / "made.csv"):
        assert read_motion(path) == (record_named(record, "made"),)
    with pytest.raises(ParameterError, match="path"):
        read_motion(3)


def record_named(record, name):
    return Record(name, record.acceleration, record.sampling_interval, record.attribution)


# --- memory --------------------------------------------------------------------------------------

POINTS = 60_000
LONG = wave(POINTS)
LARGE = {
    "at2": (at2_text(LONG), {}),
    "v1": (v1_channel(LONG, channels=1), {}),
    "knet": (knet_text([13190 + k % 997 for k in range(POINTS)]), {}),
    "csv": (csv_text(LONG), {}),
    "three channels": (
        "t [s],N [g],E [g],Z [g]\n"
        + "".join(f"{0.01 * i:.2f},{a},{-a},{a / 2:.6f}\n" for i, a in enumerate(LONG)),
        {},
    ),
    "wrapped": (
        "".join("".join(f"{v:10.6f}" for v in LONG[i : i + 8]) + "\n" for i in range(0, POINTS, 8)),
        {"units": "g", "sampling_interval": 0.01},
    ),
    "one digit a line": ("1\n0\n" * 150_000, {"units": "m/s^2", "sampling_interval": 0.01}),
    "blank lines": ("# units: g\n0.1\n0.2\n" + "\n" * 300_000, {"sampling_interval": 0.01}),
}


@pytest.mark.parametrize("case", LARGE)
def test_reading_takes_at_most_six_times_the_memory_of_the_file(case, tmp_path):
    text, options = LARGE[case]
    path = tmp_path / "made.txt"
    path.write_text(text)
    size = path.stat().st_size
    read_motion(path, **options)  # imports and caches
    tracemalloc.start()
    try:
        read_motion(path, **options)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= 6 * size + 2**20, f"{peak / size:.1f} times {size} bytes"


def test_a_record_takes_a_read_only_array_of_its_own_as_it_is():
    values = np.sin(np.arange(9.0))
    assert Record("made", values, 0.01, ()).acceleration is not values
    values.flags.writeable = False
    assert Record("made", values, 0.01, ()).acceleration is values
    assert Record("made", values[:5], 0.01, ()).acceleration.base is None


# --- scale ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("maximum", ["***", "", "nan", "1e999", "5,4"])
def test_knet_with_an_unreadable_peak_is_refused(maximum):
    line = next(line for line in KNET.split("\n") if line.startswith("Max. Acc."))
    with pytest.raises(RecordError, match="line 15"):
        parse_motion("made", KNET.replace(line, f"{'Max. Acc. (gal)':<18}{maximum}").encode())
    with pytest.raises(RecordError, match=r"Max\. Acc"):
        parse_motion("made", KNET.replace(line + "\n", "").encode())


def test_above_100_g_the_unit_is_wrong():
    text = csv_text(980.665 * 1.1 * np.sin(np.arange(50.0)), title="t [s],a [m/s^2]")
    with pytest.raises(RecordError, match="unit is wrong"):
        parse_motion("made", text.encode())
    assert parse_motion("made", text.replace("m/s^2", "gal").encode())


def test_above_3_g_a_given_unit_is_confirmed():
    text = csv_text(39.0 * np.sin(np.arange(50.0)), title="").encode()
    with pytest.raises(RecordError, match="allow_large=True"):
        parse_motion("made", text, units="m/s^2")
    (record,) = parse_motion("made", text, units="m/s^2", allow_large=True)
    assert np.max(record.acceleration) > 38.0
    assert parse_motion("made", text, units="gal")
    stated = text.replace(b"0.000,", b"# units: m/s^2\n0.000,", 1)
    assert parse_motion("made", stated) == parse_motion("made", stated, units="m/s^2")


def test_units_by_the_caller_are_read_in_linear_time():
    began = time.process_time()
    for text in ("1" * 20_000 + "x", " " * 20_000 + "x", "1 " + " " * 20_000 + "g"):
        with pytest.raises(ParameterError):
            unit_asked(text + "?")
    assert time.process_time() - began < 0.5
