"""Text in columns: which column is time, which are accelerations, in what unit, and what is refused."""

import numpy as np
import pytest
from record_texts import AT2, KNET, V1, at2_text, only, v2_channel, wave

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import GRAVITY
from shake_env.records import parse_motion, read_motion
from shake_env.records.units import quantity_of, unit_in_words, unit_named

POINTS = 400
STEP = 0.01
SECONDS = STEP * np.arange(POINTS)
# A pulse of 0.0969 g, as the file of a laboratory may hold it.
PULSE = np.round(0.1 * np.sin(4 * np.pi * SECONDS) * np.exp(-(((SECONDS - 2.0) / 0.7) ** 2)), 6)


def rows(*columns, separator=",", end="\n", formats="{:.2f}"):
    cells = [
        [(formats if c == 0 else "{:.6f}").format(v) for v in column] for c, column in enumerate(columns)
    ]
    return "".join(separator.join(line) + end for line in zip(*cells, strict=True))


TWO = rows(SECONDS, PULSE)
ONE = "".join(f"{v:.6f}\n" for v in PULSE)
COUNTED = "".join(f"{i},{i * STEP:.2f},{v:.6f}\n" for i, v in enumerate(PULSE))
WRAPPED = ["".join(f"{v:10.6f}" for v in PULSE[i : i + 8]) + "\n" for i in range(0, POINTS, 8)]
G, BOTH = {"units": "g"}, {"units": "g", "sampling_interval": STEP}
READ = {
    "pandas index": (",time,acc\n" + COUNTED, G),
    "count from 1 and a step": (
        "no,acc (g)\n" + "".join(f"{i + 1},{v}\n" for i, v in enumerate(PULSE)),
        {"sampling_interval": STEP},
    ),
    "count without titles": ("".join(f"{i} {v}\n" for i, v in enumerate(PULSE)), BOTH),
    "pandas' own numbers as titles": (",0\n" + TWO, G),
    "numpy's header": ("# Time (s), Acceleration (g)\n" + rows(SECONDS, PULSE, formats="{:.18e}"), {}),
    "quoted titles": ('"Time (s)","Acceleration (g)"\n' + TWO, {}),
    "several header lines": (
        "Made up\nStation: nowhere\nTime[s]\tAccel[g]\n" + rows(SECONDS, PULSE, separator="\t"), {}
    ),
    "a row of units": ("Time,Acc\ns,g\n" + TWO, {}),
    "a row of units in brackets": ("Time;Acc\n[s];[g]\n" + rows(SECONDS, PULSE, separator=";"), {}),
    "a unit in prose": ("Made up\nThe units are (g)\n" + TWO, {}),
    "a unit behind a title": ("time_s,acc_g\n" + TWO, {}),
    "titles parted by blanks": ("Time (s) Acc (g)\n" + rows(SECONDS, PULSE, separator="  "), {}),
    "milliseconds": ("t [ms],a [g]\n" + rows(1e3 * SECONDS, PULSE, formats="{:.0f}"), {}),
    "velocity and displacement": (
        "Time,Acceleration,Velocity,Displacement\n" + rows(SECONDS, PULSE, 3 * PULSE, 7 * PULSE), G
    ),
    "velocity and displacement by unit": (
        "t (s),ch 1 (g),ch 2 (cm/s),ch 3 (cm)\n" + rows(SECONDS, PULSE, 3 * PULSE, 7 * PULSE), {}
    ),
    "time is last": ("Acc (g),Time (s)\n" + rows(PULSE, SECONDS, formats="{:.6f}"), {}),
    "decimal commas": (
        "Zeit;Beschleunigung\n" + rows(SECONDS, PULSE, separator=";").replace(".", ","), G,
    ),
    "decimal commas and blanks": (rows(SECONDS, PULSE, separator="  ").replace(".", ","), G),
    "decimal commas in one column": (ONE.replace(".", ","), BOTH),
    "trailing commas": ("Time (s),Acceleration (g),\n" + rows(SECONDS, PULSE, end=",\n"), {}),
    "trailing commas without titles": (rows(SECONDS, PULSE, end=",\n"), G),
    "no last line end": (TWO.rstrip("\n"), G),
    "no last line end, shortest form": ("".join(f"{0.01 * i:g} {v:g}\n" for i, v in enumerate(PULSE))
                                        + "4 -3.87409e-06", G),
    "old Macintosh": (("t [s],a [g]\n" + TWO).replace("\n", "\r"), {}),
    "DOS": (("t [s],a [g]\n" + TWO).replace("\n", "\r\n") + "\x1a" * 300, {}),
    "DEEPSOIL": ("400 0.01\n" + rows(SECONDS, PULSE, separator=" "), G),
    "eqsig": ("a motion\n400 0.0100\n" + ONE, G),
    "count and step first": ("400 0.01\n" + ONE, G),
    "keys": ("Number of points: 400\nTime step (s) = 0.01\nUnits: g\n" + ONE, {}),
    "a rate": ("sampling rate: 100 Hz\nunits = g\n" + ONE, {}),
    "wrapped": ("".join(WRAPPED), BOTH),
    "wrapped by commas": ("".join(",".join(f"{v:.6f}" for v in PULSE[i : i + 5]) + "\n"
                                  for i in range(0, POINTS, 5)), BOTH),
    "wrapped, count and step first": ("400 0.01\n" + "".join(WRAPPED), G),
    "wrapped in pairs": (
        "400 0.01\n" + rows(PULSE[::2], PULSE[1::2], separator=" ", formats="{:.6f}"), G,
    ),
    "wrapped, a short last line": ("".join("".join(f"{v:10.6f}" for v in PULSE[i : i + 6]) + "\n"
                                           for i in range(0, POINTS, 6)), BOTH),
}  # fmt: skip


@pytest.mark.parametrize("case", READ)
def test_what_laboratories_write_is_read(case):
    text, options = READ[case]
    records = parse_motion("made", text.encode(), **options)
    assert len(records) == 1
    found = records[0].acceleration[:POINTS]
    assert len(records[0].acceleration) in (POINTS, POINTS + 1)
    assert np.max(np.abs(found)) == pytest.approx(0.9504, abs=5e-5)
    assert found == pytest.approx(PULSE * GRAVITY, abs=2e-5)
    assert records[0].sampling_interval == pytest.approx(STEP, rel=1e-12)
    assert "acceleration [g]" in dict(records[0].attribution)["columns read as"]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-8-sig"])
def test_encodings(encoding):
    text = "t [s],a [m/s²]\n" + TWO
    (record,) = parse_motion("made", text.encode(encoding))
    assert np.array_equal(record.acceleration, PULSE)


def test_what_each_column_was_taken_for_is_said():
    text = "Time,Acceleration,Velocity,Counts\n" + rows(SECONDS, PULSE, PULSE, PULSE)
    (record,) = parse_motion("made", text.encode(), units="g")
    assert dict(record.attribution)["columns read as"] == (
        "1 'Time': time [s]; 2 'Acceleration': acceleration [g], unit given; "
        "3 'Velocity': velocity, skipped; 4 'Counts': counts, skipped"
    )
    assert record.name == "made Acceleration"


def test_one_hertz_is_a_step_where_the_title_says_so():
    values = np.sin(0.11 * np.arange(200))
    text = "Time (s),Acceleration (m/s^2)\n" + rows(np.arange(200), values, formats="{:.0f}")
    assert only(text).sampling_interval == 1.0
    bare = text.replace("Time (s)", "Time")
    with pytest.raises(RecordError, match="may be a count"):
        only(bare)
    assert only(bare, sampling_interval=1.0).sampling_interval == 1.0


def test_times_with_too_few_decimals_need_the_step():
    text = "Time (s),Acceleration (g)\n" + rows(0.5 * SECONDS + 1e-9, PULSE)
    with pytest.raises(RecordError, match=r"0\.0050.*give sampling_interval"):
        only(text)
    assert only(text, sampling_interval=0.005).sampling_interval == 0.005
    with pytest.raises(RecordError, match="too few decimals"):
        only(text, sampling_interval=0.006)


def test_times_in_single_precision_give_the_step_that_was_meant():
    times = np.float32(0.005) * np.arange(40_000, dtype=np.float32)
    text = "".join(f"{t!s},0.1\n" for t in times)
    assert only(text, units="g").sampling_interval == 0.005


def test_a_column_is_picked_by_title_or_number():
    text = "t (s),North (g),East (g),Force (kN)\n" + rows(SECONDS, PULSE, -PULSE, PULSE)
    data = text.encode()
    assert len(parse_motion("made", data)) == 2
    for column in ("East", "east (g)", 3, "3"):
        (record,) = parse_motion("made", data, column=column)
        assert np.array_equal(record.acceleration, -PULSE * GRAVITY)
    for column, message in (("West", "one of the columns"), (9, "one of the columns"), (1, "is no acc"),
                            ("Force", "is no acceleration")):  # fmt: skip
        with pytest.raises(RecordError, match=message):
            parse_motion("made", data, column=column)
    for column in (0, True, "", 1.5):
        with pytest.raises(ParameterError, match="column"):
            parse_motion("made", data, column=column)


def test_a_channel_of_another_format_is_picked_by_name_or_place():
    records = parse_motion("made", V1.encode())
    assert parse_motion("made", V1.encode(), column=2) == records[1:2]
    assert parse_motion("made", V1.encode(), column="channel 3 (Up)") == records[2:]
    with pytest.raises(RecordError, match="channels: 1 "):
        parse_motion("made", V1.encode(), column=4)


def test_a_column_without_titles_is_picked_by_number():
    text = rows(SECONDS, PULSE, 2 * PULSE)
    with pytest.raises(RecordError, match="give column"):
        only(text, units="g")
    assert np.array_equal(only(text, units="g", column=2).acceleration, PULSE * GRAVITY)


def test_counts_are_read_by_a_given_sensitivity():
    text = "time,counts\n" + rows(SECONDS, 1e6 * PULSE)
    with pytest.raises(RecordError, match="none of the columns"):
        only(text, units="m/s^2")
    record = only(text, units="1e-6 m/s^2")
    assert record.acceleration == pytest.approx(PULSE)


TITLED = "Time (s),Acceleration (g)\n"
CHANNELS = [np.round(np.sin(0.3 * np.arange(90) + phase), 6) for phase in (0.0, 1.0, 2.0, 3.0, 4.0)]
REFUSED = {
    "unit against the file": ("# Time (s), Acceleration (g)\n" + TWO, {"units": "m/s^2"}, "differs"),
    "unit against prose": ("units of gal\n" + TWO, G, "differs"),
    "step against the times": (TITLED + TWO, {"sampling_interval": 0.02}, "differs"),
    "step against the head": ("400 0.02\n" + TWO.replace(",", " "), G, "differs"),
    "count against the rows": ("401 0.01\n" + ONE, G, "holds 400 rows"),
    "count against wrapped values": ("800 0.01\n" + "".join(WRAPPED), G, "holds 400 values"),
    "commented count against wrapped values": (
        "# npts: 399\n# dt: 0.01\n" + "".join(WRAPPED), G, "holds 400 values",
    ),
    "two units": ("units: g\nunit: gal\n" + ONE, BOTH, "states the unit"),
    "two steps": ("dt: 0.01\nrate: 1\nsampling rate: 50 Hz\nunits: g\n" + ONE, {}, "states 0.01"),
    "only velocities": ("Time (s),Velocity (m/s)\n" + TWO, {}, "none of the columns"),
    "an unknown unit": ("Time (s),Acceleration (furlong)\n" + TWO, G, "furlong"),
    "title against unit": ("Time (s),Velocity (g)\n" + TWO, {}, "different quantities"),
    "unknown titles": ("Time (s),one,two\n" + rows(SECONDS, PULSE, PULSE), G, "give column"),
    "a damaged first row": ("Time (s),Acc (g)\n0.00,0.0x1\n" + TWO, {}, "line 2"),
    "commas that may be either": ("1,5\n7,25\n3,75\n" * 5, BOTH, "decimal comma or two columns"),
    "cut in an exponent": ("0 0\n0.01 3.87409e-06\n0.02 8.33581e-06\n0.03 1.33e-0", G, "cut off"),
    "cut before an exponent": ("0 0\n0.01 3.87409e-06\n0.02 8.33581e-06\n0.03 1.33", G, "cut off"),
    "channels side by side": (rows(*CHANNELS, separator=" ", formats="{:.6f}"), BOTH, "give column"),
    "alike channels side by side": (
        rows(*[CHANNELS[0]] * 5, separator=" ", formats="{:.6f}"), BOTH, "give column",
    ),
    "no unit": ("Time (s),Acc\n" + TWO, {}, "give units"),
    "half UTF-16": ("\xff\xfea", {}, "damaged"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_contradicts_or_cannot_be_told_is_refused(case):
    text, options, message = REFUSED[case]
    with pytest.raises(RecordError, match=message):
        parse_motion("made", text.encode("latin-1"), **options)


def test_every_cut_of_a_text_without_a_line_end_is_right_or_refused():
    text = "".join(f"{t:g} {v:g}\n" for t, v in zip(SECONDS[:30], PULSE[150:180], strict=True))
    whole = only(text, units="g").acceleration
    read = 0
    for end in range(len(text) // 2, len(text)):
        try:
            found = only(text[:end], units="g").acceleration
        except RecordError:
            continue
        read += 1
        assert np.max(np.abs(found - whole[: len(found)])) < 1e-4 * np.max(np.abs(whole))
    assert read > 15


@pytest.mark.parametrize(
    ("spelling", "name"),
    [(s, name) for name, spellings in {
        "g": ("g", "G", "g's"), "%g": ("%g", "% g", "percent g"), "mg": ("mg", "milli-g"),
        "m/s^2": ("m/s2", "m/s^2", "m/s²", "m/s**2", "m/s/s", "m s-2", "m s^-2", "m.s-2", "m·s⁻²",
                  "m/(s^2)",
                  "m/sec2", "m/sec/sec", "meters per second squared"),
        "cm/s^2": ("cm/s2", "cm/s²", "cm/sec^2", "cm/sec/sec", "Gal", "gal", "cm/s/s"),
        "mm/s^2": ("mm/s2", "mm/s/s", "mm s^-2"),
        "in/s^2": ("in/s2", "in/s^2", "in/sec2", "inches/s^2"),
        "ft/s^2": ("ft/s^2", "ft/sec2", "feet/s2"),
    }.items() for s in spellings],
)  # fmt: skip
def test_spellings_of_units(spelling, name):
    assert unit_named(spelling).name == name
    record = only(f"Time (s);Acc ({spelling})\n" + rows(SECONDS, PULSE, separator=";"))
    scale = {"g": GRAVITY, "%g": GRAVITY / 100, "mg": GRAVITY / 1000, "m/s^2": 1.0, "cm/s^2": 0.01,
             "mm/s^2": 0.001, "in/s^2": 0.0254, "ft/s^2": 0.3048}[name]  # fmt: skip
    assert record.acceleration == pytest.approx(PULSE * scale, rel=1e-14)


def test_other_quantities_are_no_acceleration():
    kinds = {"cm/s": "velocity", "m s-1": "velocity", "mm": "displacement", "s": "time", 
             "counts": "counts", "kN": "another quantity", "knots": None, "": None}  # fmt: skip
    for text, kind in kinds.items():
        quantity = quantity_of(text)
        assert (quantity and quantity[0]) == kind
        assert unit_named(text) is None
    assert unit_in_words("IN UNITS OF cm/sec/sec, filtered") == "cm/sec/sec"
    assert unit_in_words("The units are (g)") == "g"
    assert unit_in_words("nothing of the kind") is None


# --- PEER and CSMIP ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "header",
    [
        "NPTS= {n}, DT=   {step} SEC,  -5 POLE @      .03000 HZ,   0 POLE @      .00000",
        "NPTS= {n}, DT= {step} SEC. LOW PASS 40 HZ",
        "NPTS= {n}, DT= {step}SEC",
    ],
)
def test_peer_text_after_the_step(header):
    record = only(at2_text(wave(23), "0.0100", header=header))
    assert record.sampling_interval == 0.01
    assert np.array_equal(record.acceleration, wave(23) * GRAVITY)


def test_peer_units_in_words():
    text = AT2.replace("ACCELERATION TIME HISTORY IN UNITS OF G", "The units are (g)")
    assert np.array_equal(only(text).acceleration, only(AT2).acceleration)
    with pytest.raises(RecordError, match="differs"):
        only(text, units="gal")


def test_csmip_channel_of_the_station_ends_the_recorders():
    text = v2_channel(wave(19, 80.0), channels=1)
    beside = text.replace("Chan  1:  H1", "Chan  1:  H1  (Sta Chn:  6)     Location: roof")
    beside = beside.replace("channel  1  ---", "channel  6  ---")
    record = only(beside)
    assert record.name == "made channel 1 (H1)"
    assert np.array_equal(record.acceleration, only(text).acceleration)
    with pytest.raises(RecordError, match="another channel"):
        only(beside.replace("channel  6  ---", "channel  7  ---"))


@pytest.mark.parametrize("text", [AT2, V1, KNET])
def test_dos_end_of_file_marks_are_left_out(text):
    padded = parse_motion("made", text.encode() + b"\x1a" * 300)
    assert padded == parse_motion("made", text.encode())


def test_the_column_reaches_the_file_by_its_path(tmp_path):
    path = tmp_path / "made.csv"
    path.write_text("t (s),N (g),E (g)\n" + rows(SECONDS, PULSE, -PULSE))
    (record,) = read_motion(str(path), column="E")
    assert record.name == "made E [g]"
