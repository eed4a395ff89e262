"""Records as they are kept and read: the embedded ones, and every text that is none."""

import math
from importlib import resources

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from shake_env import RECORD_NAMES, Record, RecordedMotion, load_record
from shake_env.errors import RecordError
from shake_env.model.parameters import GRAVITY
from shake_env.motion.targets import target_history
from shake_env.records import parse_record


def made_record(acceleration, interval=0.01, name="made"):
    return Record(name, np.asarray(acceleration, dtype=float), interval, (("event", "made"),))


def embedded_text(name):
    return resources.files("shake_env.records").joinpath(f"{name}.csv").read_text(encoding="utf-8")


def test_there_are_six_records():
    assert len(set(RECORD_NAMES)) == 6
    files = {p.name for p in resources.files("shake_env.records").iterdir() if p.name.endswith(".csv")}
    assert files == {f"{name}.csv" for name in RECORD_NAMES}


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_embedded_record_is_what_its_header_says(name):
    record = load_record(name)
    lines = embedded_text(name).splitlines()
    header = dict(line[2:].split(": ", 1) for line in lines if line.startswith("#"))
    samples = [float(line) for line in lines if not line.startswith("#") and line != "acceleration"]
    assert len(record.acceleration) == int(header["points"]) == len(samples)
    assert record.sampling_interval == float(header["sampling_interval_s"])
    assert record.acceleration == pytest.approx(np.array(samples) * 9.80665, rel=1e-15)
    assert dict(record.attribution) == header
    for key in ("event", "station", "component", "network", "licence", "source"):
        assert header[key]
    assert "CESMD" in header["network"] and "attribution" in header["licence"]
    # An earthquake in m/s^2, not in g or cm/s^2.
    assert 1.0 < np.max(np.abs(record.acceleration)) < 10.0


@pytest.mark.parametrize(
    ("prefix", "interval", "points", "seconds"),
    [("ridgecrest2019", 0.01, 6000, 59.99), ("napa2014", 0.005, 6997, 34.98)],
)
def test_steps_and_counts_of_the_records(prefix, interval, points, seconds):
    names = [name for name in RECORD_NAMES if name.startswith(prefix)]
    assert len(names) in (2, 4)
    for name in names:
        record = load_record(name)
        assert (record.sampling_interval, len(record.acceleration)) == (interval, points)
        assert record.duration == pytest.approx(seconds, rel=1e-12)


def test_a_record_is_read_only_and_compared_by_its_samples():
    record = load_record(RECORD_NAMES[0])
    with pytest.raises(ValueError, match="read-only"):
        record.acceleration[0] = 1.0
    source = np.sin(np.arange(50.0))
    one, same, other = made_record(source), made_record(source.copy()), made_record(2.0 * source)
    assert one == same and hash(one) == hash(same)
    assert one != other  # what is computed from a record is cached by the record
    source[0] = 99.0
    assert one.acceleration[0] == 0.0


def test_two_records_of_one_name_are_two_motions():
    values = np.sin(4.0 * np.pi * np.arange(0.0, 20.0, 0.01) + 0.4)
    histories = [
        target_history(RecordedMotion(record=made_record(s * values)), 1e-3) for s in (1.0, 2.0)
    ]
    difference = histories[1].acceleration - 2.0 * histories[0].acceleration
    assert np.max(np.abs(difference)) < 1e-12 < np.max(np.abs(histories[0].acceleration))


@pytest.mark.parametrize(
    ("acceleration", "interval", "message"),
    [
        (np.array([1.0]), 0.01, r"acceleration shape = \(1,\)"),
        (np.zeros((3, 2)), 0.01, r"acceleration shape = \(3, 2\)"),
        (np.array([0.0, np.nan]), 0.01, "sample 1 = nan"),
        (np.zeros(5), 0.0, "sampling_interval_s = 0.0"),
        (np.zeros(5), math.nan, "sampling_interval_s = nan"),
    ],
)
def test_bad_record_raises_a_record_error(acceleration, interval, message):
    with pytest.raises(RecordError, match=message):
        Record("made", acceleration, interval, ())


def small_text(points=4, samples=("0.1", "-0.2", "0.3", "0.0"), **header):
    lines = {
        "event": "e",
        "station": "s",
        "component": "c",
        "network": "n",
        "licence": "l",
        "sampling_interval_s": "0.01",
        "points": str(points),
        "units": "g",
        **header,
    }
    head = [f"# {key}: {value}" for key, value in lines.items() if value is not None]
    return "\n".join([*head, "acceleration", *samples]) + "\n"


def test_small_text_is_a_record():
    record = parse_record("small", small_text())
    assert record.acceleration == pytest.approx(np.array([0.1, -0.2, 0.3, 0.0]) * GRAVITY)


@pytest.mark.parametrize(
    ("text", "place", "value"),
    [
        (small_text(points=5), "points", "5"),
        (small_text(samples=("0.1", "-0.2", "0.3")), "points", "4"),
        (small_text(samples=("0.1", "-0.2", "0.3", "0.0", "0.0")), "points", "4"),
        (small_text(points=1, samples=("0.1",)), "points", "1"),
        (small_text(points="4.5"), "points", "4.5"),
        (small_text(points="many"), "points", "many"),
        (small_text(points="nan"), "points", "nan"),
        (small_text(samples=("0.1", "nan", "0.3", "0.0")), "line 11", "nan"),
        (small_text(samples=("0.1", "-inf", "0.3", "0.0")), "line 11", "-inf"),
        (small_text(samples=("0.1", "1e308", "0.3", "0.0")), "line 11", "1e308"),
        (small_text(samples=("0.1", "shake", "0.3", "0.0")), "line 11", "shake"),
        (small_text(samples=("0.1", "", "0.3", "0.0")), "line 11", ""),
        (small_text(samples=("0.1", "1_0", "0.3", "0.0")), "line 11", "1_0"),
        (small_text(samples=("0.1", "\u0663", "0.3", "0.0")), "line 11", "\u0663"),
        (small_text(samples=("0.1", "0.2,0.3", "0.3", "0.0")), "line 11", "0.2,0.3"),
        (small_text(samples=("0.1", "# a: b", "0.3", "0.0")), "line 11", "# a: b"),
        (small_text(units="m/s^2"), "units", "m/s^2"),
        (small_text(units=None), "header", "units"),
        (small_text(licence=None), "header", "licence"),
        (small_text(sampling_interval_s="0"), "sampling_interval_s", "0"),
        (small_text(sampling_interval_s="-0.01"), "sampling_interval_s", "-0.01"),
        (small_text(sampling_interval_s="fast"), "sampling_interval_s", "fast"),
        (small_text(sampling_interval_s="inf"), "sampling_interval_s", "inf"),
        (small_text().replace("acceleration", "velocity"), "line 9", "velocity"),
        (small_text().replace("acceleration\n", ""), "line 9", "0.1"),
        (small_text().replace("# event: e", "# event e"), "line 1", "# event e"),
        ("# points: 3\n" + small_text(), "line 8", "points: 4"),
        ("", "header", "event"),
    ],
)
def test_a_spoilt_record_raises_an_error_that_names_place_and_value(text, place, value):
    with pytest.raises(RecordError) as caught:
        parse_record("small", text)
    assert caught.value.field.startswith("small") and place in caught.value.field
    assert value in str(caught.value)
    assert caught.value.remedy


def test_a_truncated_record_is_refused():
    text = embedded_text(RECORD_NAMES[0])
    for share in (0.3, 0.9, 0.999):
        with pytest.raises(RecordError, match=r"points|line"):
            parse_record("cut", text[: int(share * len(text))])


@settings(
    max_examples=300,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow],
)
@given(
    edits=st.lists(
        st.tuples(
            st.sampled_from(["delete", "insert", "replace", "cut", "repeat line"]),
            st.floats(0.0, 1.0, exclude_max=True),
            st.one_of(
                st.sampled_from(["\n", "#", "nan", "1e999", "-", ".", "e", "_", "\x00", ":", "9", "\r"]),
                st.text(max_size=4),
            ),
        ),
        min_size=1,
        max_size=4,
    )
)
def test_any_edit_of_a_record_is_read_soundly_or_refused(edits):
    text = small_text(points=6, samples=("0.1", "-0.2", "0.3", "0.0", "1.5e-3", "-2"))
    for kind, share, piece in edits:
        i = int(share * len(text))
        if kind == "delete":
            text = text[:i] + text[i + 1 + len(piece) :]
        elif kind == "insert":
            text = text[:i] + piece + text[i:]
        elif kind == "replace":
            text = text[:i] + piece + text[i + 1 :]
        elif kind == "cut":
            text = text[:i]
        else:
            lines = text.splitlines()
            at = int(share * len(lines))
            text = "\n".join([*lines[:at], *lines[at : at + 1], *lines[at:]])
    try:
        record = parse_record("edited", text)
    except RecordError as error:
        assert error.field.startswith("edited") and error.remedy
        return
    header = dict(record.attribution)
    assert len(record.acceleration) == float(header["points"]) >= 2
    assert np.all(np.isfinite(record.acceleration))
    assert record.sampling_interval > 0.0 and math.isfinite(record.sampling_interval)
    assert header["units"] == "g"
    # Text lines after the column's name, as a person counts them: an empty one is none.
    # Lines end with a line feed: a carriage return within a remark ends none.
    lines = [line for line in text.split("\n") if line.strip() and not line.startswith("#")]
    assert len(record.acceleration) == len(lines) - 1
