"""Readers of recorded motions: every format, what they refuse and how, and files damaged at random."""

import math
import random
import sys
import time
import types
from pathlib import Path

import numpy as np
import pytest

from shake_env.errors import ParameterError, RecordError
from shake_env.parameters import GRAVITY
from shake_env.records import RECORD_NAMES, Record, load_record, parse_motion, read_motion, write_record

CICLC = Path(__file__).parent / "data" / "CICLC_trimmed.v1"


def wave(points, scale=0.3, phase=0.0):
    """Values of six decimals that no two lines share."""
    time_ = np.arange(points)
    values = scale * np.sin(0.37 * time_ + phase) * np.exp(-0.01 * time_) + 1e-4 * np.cos(time_**2)
    return np.round(values, 6)


def fortran(values, columns, width, decimals, end="\n"):
    """Text of (columns F width.decimals), with no zero before the point, as CSMIP writes it."""
    cells = [
        f"{v:.{decimals}f}".replace("0.", ".", 1) if abs(v) < 1 else f"{v:.{decimals}f}" for v in values
    ]
    cells = [cell.rjust(width) for cell in cells]
    assert all(len(cell) == width for cell in cells)
    return "".join("".join(cells[i : i + columns]) + end for i in range(0, len(cells), columns))


def at2_text(values, step=".01000", *, header="NPTS= {n:5d}, DT= {step} SEC", unit="G", points=None):
    head = header.format(n=len(values) if points is None else points, step=step)
    cells = [f"{v:15.7E}" for v in values]
    body = "".join("".join(cells[i : i + 5]) + "\n" for i in range(0, len(cells), 5))
    return (
        "PEER NGA STRONG MOTION DATABASE RECORD\nEVENT 10/15/79 2319, STATION 6, 230\n"
        f"ACCELERATION TIME HISTORY IN UNITS OF {unit}\n{head}\n{body}"
    )


NUMBERS = "    1  100    1    3    3  100 -999    3    1    0\n  .0050000  .7071000 319.32000\n"


def v1_channel(values, number=1, label="90 Deg", rate=100, channels=3, **changed):
    n = len(values)
    peak = np.max(np.abs(values))
    line = f"{n:6d} Accelerogram points at {rate} pts/sec in units of g.       Format: (8f9.6)"
    return (
        "Uncorrected Accelerogram Data             Processed: 07/06/19, CGS  made\n"
        f"Station Id. XYZ  35.8N, 117.6W   Q330    s/n 4323  ({channels} Chns of  {channels} at Sta)\n"
        f"Chan {number:2d}:  {label}\n"
        f"No. of Points = {changed.get('points', n):6d}"
        f"  Record Length ={changed.get('length', n / rate):7.3f} sec"
        f"   at {changed.get('header_rate', rate)} Samples/sec\n"
        "Units of uncor data are sec and g.         "
        f"Max  = {changed.get('peak', f'{peak:.3f}')} g, at    1.000 sec.\n"
        f"{NUMBERS}{changed.get('line', line)}\n{fortran(values, 8, 9, 6)}"
        f"/&  ----------  End of Data for Station Channel   {number}  ----------\n"
    )


def v1_text(points=21, channels=3):
    labels = ("90 Deg", "360 Deg", "Up")
    series = [wave(points + k, phase=float(k)) for k in range(channels)]
    text = "".join(
        v1_channel(values, k + 1, labels[k], channels=channels) for k, values in enumerate(series)
    )
    return text, series


def v2_channel(acceleration, number=1, step=".020", channels=2, unit="cm/sec2", **changed):
    n = len(acceleration)
    velocity, displacement = wave(n, 2.0, 0.3), wave(n, 0.5, 0.9)
    counts = {"accel": n, "veloc": n, "displ": n, **changed.get("counts", {})}
    blocks = ""
    for kind, values, u in (
        ("accel", acceleration, unit), ("veloc", velocity, "cm/sec"), ("displ", displacement, "cm"),
    ):  # fmt: skip
        if kind not in changed.get("without", ()):
            blocks += f"{counts[kind]:6d} points of {kind} data equally spaced at  {step} sec"
            blocks += f", in {u}. (8f10.6)\n"
            blocks += fortran(values, 8, 10, 6 if np.max(np.abs(values)) < 100 else 5)
    return (
        f"Corrected accelerogram   XYZ      Chan {number:2d}:  H{number}    from\n"
        "Uncorrected Accelerogram Data             Processed: 04/30/14, CGS  made\n"
        f"Station Id. XYZ     34.0N, 117.9W       s/n 4310  ({channels} Chns of  {channels} at Sta)\n"
        f"Chan {number:2d}:  H{number}\n"
        f"                        Record length ={n * float(step):7.3f} sec.\n"
        "                                     Uncor Max  =   .086 g , at  14.830 sec.\n"
        f"{n:6d} points of instrument- and baseline-corrected accel, veloc and displ data\n"
        f"At equally-spaced intervals of    {changed.get('spacing', step)}  sec.\n"
        f"Peak acceleration = {changed.get('peak', f'{np.max(np.abs(acceleration)):9.3f}')}"
        "    cm/sec/sec  at   1.0   sec.\n"
        f"{NUMBERS}{blocks}/&  ----------  End of data for channel  {number}  ----------\n"
    )


def v2_text(points=19):
    series = [wave(points, 80.0), wave(points, 30.0, 1.0)]
    return "".join(v2_channel(values, k + 1) for k, values in enumerate(series)), series


def knet_text(counts, *, scale="3920(gal)/6182761", rate="100Hz", duration=None, maximum=None):
    above, below = scale.split("(gal)/")
    factor = float(above) / float(below)
    acceleration = np.asarray(counts) * factor
    shown = maximum or f"{np.max(np.abs(acceleration - acceleration.mean())):.3f}"
    lines = [
        ("Origin Time", "2018/01/24 19:51:00"), ("Lat.", "41.0"), ("Long.", "142.5"),
        ("Depth. (km)", "30"), ("Mag.", "6.2"), ("Station Code", "AOM001"),
        ("Station Lat.", "41.5267"), ("Station Long.", "140.9244"), ("Station Height(m)", "39"),
        ("Record Time", "2018/01/24 19:51:43"), ("Sampling Freq(Hz)", rate),
        ("Duration Time(s)", str(len(counts) // 100 if duration is None else duration)), ("Dir.", "N-S"),
        ("Scale Factor", scale), ("Max. Acc. (gal)", shown),
        ("Last Correction", "2018/01/24 19:51:43"), ("Memo.", ""),
    ]  # fmt: skip
    head = "".join(f"{key:<18}{value}\n" for key, value in lines)
    rows = ["".join(f"{c:8d} " for c in counts[i : i + 8]) + "\n" for i in range(0, len(counts), 8)]
    return head + "".join(rows)


def knet_counts(points=100):
    return [13190 + round(4000 * math.sin(0.31 * i) * math.exp(-0.02 * i)) for i in range(points)]


def csv_text(values, step=0.005, title="time [s],acceleration [g]", separator=","):
    rows = (f"{i * step:.3f}{separator}{v:.6f}\n" for i, v in enumerate(values))
    return f"{title}\n" * bool(title) + "".join(rows)


def only(text, **options):
    (record,) = parse_motion("made", text.encode(), **options)
    return record


# --- each format, read right ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("header", "step"),
    [
        ("NPTS= {n:5d}, DT= {step} SEC", ".01000"),
        ("NPTS=  {n:5d}, DT=   {step} SEC,", ".0050"),
        ("NPTS={n}, DT={step} SEC", "0.02"),
        ("NPTS={n} DT={step}", "0.0024"),
        ("{n:5d}    {step}    NPTS, DT", "0.0100"),
        ("  {n} {step} NPTS,DT", "0.004"),
    ],
)
def test_peer_headers_of_every_age(header, step):
    record = only(at2_text(wave(23), step, header=header))
    assert np.array_equal(record.acceleration, wave(23) * GRAVITY)
    assert record.sampling_interval == float(step)
    assert record.name == "made" and ("format", "PEER AT2") in record.attribution
    assert any("STATION 6" in text for _, text in record.attribution)


def test_peer_numbers_may_touch_in_their_columns():
    head = at2_text(wave(12)).split("\n")[:4]
    rows = ["-123.4567-234.5678" * 4, "-123.4567-234.5678" * 2]
    record = only("\n".join([*head, *rows]) + "\n")
    assert np.array_equal(record.acceleration, np.array([-123.4567, -234.5678] * 6) * GRAVITY)


def test_the_real_csmip_volume_1_file_gives_three_channels():
    records = read_motion(CICLC)
    assert [record.name for record in records] == [
        "CICLC_trimmed channel 1 (90 Deg)",
        "CICLC_trimmed channel 2 (360 Deg)",
        "CICLC_trimmed channel 3 (Up)",
    ]
    peaks = [np.max(np.abs(record.acceleration)) / GRAVITY for record in records]
    assert peaks == pytest.approx([0.344250, 0.510799, 0.347089], abs=5e-7)
    for record, at in zip(records, (4.36, 5.70, 4.39), strict=True):
        assert len(record.acceleration) == 800 and record.sampling_interval == 0.01
        assert np.argmax(np.abs(record.acceleration)) * 0.01 == pytest.approx(at)
        assert any("China Lake" in text for _, text in record.attribution)
    # The same station, event and trim as two of the embedded records, which lost their offset.
    embedded = load_record("ridgecrest2019_clc_90").acceleration
    best = np.argmax(np.abs(embedded)) - 436
    difference = records[0].acceleration - embedded[best : best + 800]
    assert np.max(np.abs(difference - difference.mean())) < 2e-5


def test_csmip_volume_1_written_by_the_test():
    text, series = v1_text()
    for form in (text, text.replace("\n", "\r\n"), text.replace("\n", "   \n")):
        records = parse_motion("made", form.encode())
        assert len(records) == 3
        for record, values in zip(records, series, strict=True):
            assert np.array_equal(record.acceleration, values * GRAVITY)
            assert record.sampling_interval == 0.01


def test_csmip_columns_may_touch():
    values = np.round(-np.abs(wave(24)) - 10.0, 6)  # '-10.123456' fills f10.6, '-1.123456' fills f9.6
    text = v2_channel(values, channels=1)
    assert np.array_equal(only(text).acceleration, values / 100.0)
    values = np.round(-np.abs(wave(24)) - 1.0, 6)
    assert "-1.000100-1.107" in fortran(values, 8, 9, 6)
    assert np.array_equal(only(v1_channel(values, channels=1)).acceleration, values * GRAVITY)


def test_csmip_volume_2_gives_the_accelerations():
    text, series = v2_text()
    records = parse_motion("made", text.encode())
    for record, values in zip(records, series, strict=True):
        assert np.array_equal(record.acceleration, values / 100.0)
        assert record.sampling_interval == 0.02
    assert records[1].name == "made channel 2 (H2)"


def test_csmip_files_of_the_eighties_have_no_format_and_capital_letters():
    values = wave(20, 0.2)
    text = v1_channel(
        values, channels=1, line="    20 POINTS OF ACCEL DATA EQUALLY SPACED AT .010 SEC.  (UNITS: G)"
    )
    text = text.replace("Uncorrected Accelerogram Data", "UNCORRECTED ACCELEROGRAM DATA")
    assert np.array_equal(only(text).acceleration, values * GRAVITY)
    values = np.round(wave(19, 200.0), 3)
    text = v2_channel(values, channels=1).replace("Corrected accelerogram", "CORRECTED ACCELEROGRAM")
    lines = []
    for line in text.split("\n"):
        if "equally spaced at" in line:
            line = line.split(", in")[0].upper() + ".  (UNITS: CM/SEC/SEC)"
        lines.append(line)
    record = only("\n".join(lines))
    assert np.array_equal(record.acceleration, values / 100.0)


def test_one_channel_of_an_array_is_read_alone():
    text = v1_channel(wave(20), number=7, channels=12)
    assert only(text).name == "made channel 7 (90 Deg)"


def test_knet_counts_times_the_scale_factor():
    counts = knet_counts(200)
    record = only(knet_text(counts))
    assert record.acceleration == pytest.approx(np.array(counts) * 3920 / 6182761 / 100, rel=1e-15)
    assert record.sampling_interval == 0.01
    assert dict(record.attribution)["Station Code"] == "AOM001"


@pytest.mark.parametrize(
    ("title", "separator", "factor"),
    [
        ("time [s],acceleration [g]", ",", GRAVITY),
        ("Time(sec);Acc(m/s^2)", ";", 1.0),
        ("t [s]\ta [cm/s2]", "\t", 0.01),
        ("# units: gal", "  ", 0.01),
        ("% units: mm/s^2", " , ", 0.001),
    ],
)
def test_columns_of_time_and_acceleration(title, separator, factor):
    record = only(csv_text(wave(40), title=title, separator=separator))
    assert record.acceleration == pytest.approx(wave(40) * factor, rel=1e-15)
    assert record.sampling_interval == 0.005


def test_columns_take_unit_and_step_from_the_caller():
    text = csv_text(wave(40), title="")
    assert np.array_equal(only(text, units="g").acceleration, wave(40) * GRAVITY)
    column = "".join(f"{v:.6f}\n" for v in wave(40))
    record = only(column, units="4.2e-7 m/s^2", sampling_interval=0.002)
    assert record.acceleration == pytest.approx(wave(40) * 4.2e-7)
    assert record.sampling_interval == 0.002


def test_each_further_column_is_a_channel():
    rows = "".join(f"{i * 0.01:.2f},{a:.6f},{-a:.6f}\n" for i, a in enumerate(wave(20)))
    north, east = parse_motion("made", ("t [s],N [g],E [g]\n" + rows).encode())
    assert (north.name, east.name) == ("made N [g]", "made E [g]")
    assert np.array_equal(north.acceleration, -east.acceleration)


@pytest.mark.parametrize("name", RECORD_NAMES)
def test_embedded_records_survive_write_and_read_bit_for_bit(name, tmp_path):
    record = load_record(name)
    (back,) = read_motion(write_record(record, tmp_path / f"{name}.csv"))
    assert back == record
    assert back.acceleration.tobytes() == record.acceleration.tobytes()
    assert back.attribution == record.attribution


def test_any_record_survives_write_and_read_bit_for_bit(tmp_path):
    rng = np.random.default_rng(3)
    for scale in (1e-300, 1e-9, 1.0, 1e200):
        values = scale * rng.standard_normal(2000)
        values[:2] = 0.0, -0.0
        record = Record("any", values, 1.0 / 3.0, (("event", "Ñuble, 地震"),))
        (back,) = read_motion(write_record(record, tmp_path / "any.csv"))
        assert back.acceleration.tobytes() == record.acceleration.tobytes()
        assert back.sampling_interval == record.sampling_interval
        assert dict(back.attribution)["event"] == "Ñuble, 地震"


def test_every_format_survives_write_and_read(tmp_path):
    texts = [at2_text(wave(23)), v1_text()[0], v2_text()[0], knet_text(knet_counts()), csv_text(wave(9))]
    for text in texts:
        for record in parse_motion("made", text.encode()):
            (back,) = read_motion(write_record(record, tmp_path / "made.csv"))
            assert back.acceleration.tobytes() == record.acceleration.tobytes()
            assert set(record.attribution) <= set(back.attribution)


@pytest.mark.parametrize("entry", [("a", "b\nc"), ("a:b", "c"), (" a", "b"), ("a", "b\x1c")])
def test_write_refuses_what_would_not_read_back(entry, tmp_path):
    record = Record("made", wave(9), 0.01, (entry,))
    with pytest.raises(RecordError, match="attribution"):
        write_record(record, tmp_path / "made.csv")


def test_write_refuses_a_place_it_cannot_write_to(tmp_path):
    with pytest.raises(RecordError, match="written"):
        write_record(load_record(RECORD_NAMES[0]), tmp_path / "absent" / "made.csv")


# --- what is refused, and how --------------------------------------------------------------------

AT2 = at2_text(wave(23))
V1 = v1_text()[0]
V2 = v2_text()[0]
KNET = knet_text(knet_counts())
CSV = csv_text(wave(20))


def without_line(text, number):
    lines = text.split("\n")
    return "\n".join(lines[: number - 1] + lines[number:])


REFUSED = {
    "at2 count": (at2_text(wave(23), points=24), "line 4", "NPTS 24"),
    "at2 count below": (at2_text(wave(23), points=22), "line 4", "holds 23"),
    "at2 absurd count": (at2_text(wave(23), points=10**40), "line 4", "holds 23"),
    "at2 one point": (at2_text(wave(1)), "line 4", "2 at least"),
    "at2 step 0": (at2_text(wave(23), ".0000"), "line 4", "above 0"),
    "at2 step": (at2_text(wave(23), ".0l00"), "line 4", "expected 'NPTS="),
    "at2 unit": (at2_text(wave(23), unit="FURLONGS"), "line 3", "FURLONGS"),
    "at2 no unit": (AT2.replace("IN UNITS OF G", ""), "line 4", "give units"),
    "at2 velocity": (AT2.replace("ACCELERATION", "VELOCITY"), "line 3", "no acceleration"),
    "at2 letters": (AT2.replace("E-", "X-", 1), "line 5", "not a number"),
    "at2 nan": (AT2.replace(f"{wave(23)[3]:15.7E}", "            NaN"), "line 5", "NaN"),
    "at2 overflow": (AT2.replace("E-04", "E999", 1), "line 5", "E999"),
    "at2 two points in a number": (
        AT2.replace(f"{wave(23)[7]:.7E}", "1.2.345678E-01"),
        "line 6",
        "1.2.3",
    ),
    "at2 short": (without_line(AT2, 6), "line 4", "holds 18"),
    "at2 cut within the last number": (AT2.rstrip("\n")[:-1], "line 9", "cut off"),
    "v1 count": (v1_channel(wave(20), channels=1, points=21), "line 4", "21 points"),
    "v1 rate": (v1_channel(wave(20), channels=1, header_rate=200), "line 4", "0.005"),
    "v1 length": (v1_channel(wave(20), channels=1, length=9.0), "line 4", "9.000"),
    "v1 peak": (v1_channel(wave(20), channels=1, peak=".999"), "line 5", "peak .999"),
    "v1 unit": (V1.replace("in units of g.", "in units of q."), "line 8", "q."),
    "v1 other unit": (V1.replace("in units of g.", "in units of gal."), "line 5", "peak"),
    "v1 format": (V1.replace("(8f9.6)", "(8f9"), "line 8", "(8f9.6)"),
    "v1 short": (without_line(V1, 10), "line 10", "field 6 of 8"),
    "v1 long": (V1.replace("\n/&", "\n  .000001\n/&", 1), "line 12", "more than"),
    "v1 field": (V1.replace(" .000100", " .0x0100"), "line 9", "field 1 of 8"),
    "v1 too few channels": (V1[: V1.index("Uncorrected", 10)], "line 2", "3 Chns"),
    "v1 channel twice": (V1.replace("Chan  2:", "Chan  1:"), "line", "channel 1"),
    "v1 wrong end": (V1.replace("Channel   1", "Channel   7"), "line", "another channel"),
    "v1 count in the block": (V1.replace("21 Accel", "22 Accel"), "line", ""),
    "v2 velocity count": (v2_channel(wave(19, 80.0), channels=1, counts={"veloc": 18}), "line", ""),
    "v2 no displacement": (v2_channel(wave(19, 80.0), channels=1, without=("displ",)), "line", "displ"),
    "v2 no acceleration": (v2_channel(wave(19, 80.0), channels=1, without=("accel",)), "line", "accel"),
    "v2 spacing": (v2_channel(wave(19, 80.0), channels=1, spacing=".010"), "line 8", "0.01"),
    "v2 peak": (v2_channel(wave(19, 80.0), channels=1, peak="8.258"), "line 9", "8.258"),
    "v2 unit": (v2_channel(wave(19, 80.0), channels=1, unit="g"), "line 9", "peak"),
    "v2 truncated": (V2[: len(V2) // 3], "line", ""),
    "knet duration": (knet_text(knet_counts(), duration=2), "line 12", "Duration Time 2"),
    "knet rate": (knet_text(knet_counts(), rate="200Hz"), "line 12", "200 Hz"),
    "knet rate unit": (knet_text(knet_counts(), rate="100"), "line 11", "100Hz"),
    "knet scale": (KNET.replace("3920(gal)", "3920(gel)"), "line 14", "gel"),
    "knet zero scale": (KNET.replace("3920(gal)", "0(gal)"), "line 14", "3920(gal)"),
    "knet peak": (knet_text(knet_counts(), maximum="99.000"), "line 15", "99.000"),
    "knet memo": (KNET.replace("Memo", "Mxmo"), "line 1", "Memo."),
    "knet fraction": (KNET.replace("   13190 ", " 13190.5 ", 1), "line 18", "13190.5"),
    "knet missing line": (without_line(KNET, 14), "line 16", "Scale Factor"),
    "knet twice": (KNET.replace("Lat.  ", "Mag.  ", 1), "line 5", "again"),
    "csv lost line": (without_line(CSV, 9), "line 9", "evenly"),
    "csv same time": (CSV.replace("0.010,", "0.005,"), "line", "evenly"),
    "csv falling time": (CSV.replace("\n0.", "\n-0."), "line 2", "rising"),
    "csv columns": (CSV.replace("0.020,", "0.020,1,"), "line 6", "3 columns"),
    "csv empty cell": (CSV.replace("0.020,", "0.020,,"), "line 6", "columns"),
    "csv blanks for commas": (CSV.replace("\n0.020,", "\n,0.020 "), "line 6", ""),
    "csv blank line": (CSV.replace("\n0.020,", "\n\n0.020,"), "line 6", "blank"),
    "csv no unit": (csv_text(wave(9), title=""), "line 1", "give units"),
    "csv unknown unit": (CSV.replace("[g]", "[knots]"), "line 1", "knots"),
    "csv time unit": (CSV.replace("[s]", "[min]"), "line 1", "min"),
    "csv count": ("# points: 21\n" + CSV, "line 1", "holds 20"),
    "csv step": ("# sampling_interval_s: 0.01\n" + CSV, "line 3", "0.01"),
    "csv cut within a number": (CSV[:-3], "line 21", "cut off"),
    "one column without a step": ("# units: g\n0.1\n0.2\n", "line 2", "sampling_interval"),
    "one row": ("# units: g\n0.0,0.1\n", "line 2", "2 samples"),
    "only comments": ("# units: g\n", "made", "no data"),
    "prose": ("Dear all,\nplease find attached\n", "line 1", "known formats"),
    "empty": ("\n \n", "made", "empty"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_by_line_and_value(case):
    text, place, value = REFUSED[case]
    with pytest.raises(RecordError) as caught:
        parse_motion("made", text.encode())
    assert caught.value.field.startswith("made") and place in caught.value.field
    assert value in str(caught.value)
    assert caught.value.remedy


def test_v1_short_block_names_the_line_that_is_no_data():
    text = V1.replace("21 Accel", "29 Accel", 1).replace(
        "=     21  Record Length =  0.210", "=     29  Record Length =  0.290", 1
    )
    with pytest.raises(RecordError, match=r"made, line 11 .*field 6 of 8"):
        parse_motion("made", text.encode())


@pytest.mark.parametrize(
    ("text", "options", "match"),
    [
        (AT2, {"units": "m/s^2"}, "differs from the given m/s"),
        (AT2, {"sampling_interval": 0.02}, r"differs from the given 0\.02 s"),
        (V1, {"units": "gal"}, "differs"),
        (KNET, {"units": "g"}, "differs"),
        (CSV, {"sampling_interval": 0.01}, "differs"),
    ],
)
def test_what_a_file_says_of_itself_stands_against_the_caller(text, options, match):
    with pytest.raises(RecordError, match=match):
        parse_motion("made", text.encode(), **options)


def test_agreeing_options_change_nothing():
    for text, options in (
        (AT2, {"units": "g"}),
        (V1, {"sampling_interval": 0.01}),
        (KNET, {"units": "gal"}),
    ):
        assert parse_motion("made", text.encode(), **options) == parse_motion("made", text.encode())


@pytest.mark.parametrize(
    "options",
    [{"units": "furlong"}, {"units": 3}, {"units": "0 g"}, {"units": "1e999 g"},
     {"sampling_interval": 0.0},
     {"sampling_interval": math.nan}, {"sampling_interval": "fast"}],
)  # fmt: skip
def test_senseless_options_are_refused(options):
    with pytest.raises(ParameterError):
        parse_motion("made", AT2.encode(), **options)


@pytest.mark.parametrize("path", ["absent.at2", "\0", "."])
def test_a_file_that_cannot_be_read_is_a_record_error(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordError, match="can be read"):
        read_motion(path)


# --- ObsPy ---------------------------------------------------------------------------------------

BINARY = b"000001D \0\0\0\0" * 20


def test_binary_files_name_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "obspy", None)
    with pytest.raises(RecordError, match=r"pip install 'shake-env\[obspy\]'"):
        parse_motion("made", BINARY, units="m/s^2")


def fake_obspy(monkeypatch, traces=(), error=None):
    class Stats(types.SimpleNamespace):
        def __contains__(self, key):
            return hasattr(self, key)

        def get(self, key, default=None):
            return getattr(self, key, default)

    def read(stream):
        if error is not None:
            raise error
        return [
            types.SimpleNamespace(
                id=f"XX.STA..{channel}", data=data,
                stats=Stats(
                    npts=npts, delta=0.01, network="XX", station="STA", channel=channel, starttime=0
                ),
            )
            for channel, data, npts in traces
        ]  # fmt: skip

    monkeypatch.setitem(sys.modules, "obspy", types.SimpleNamespace(read=read))


def test_binary_files_through_obspy_need_a_unit(monkeypatch):
    counts = np.arange(50, dtype=np.int32)
    fake_obspy(monkeypatch, [("HNE", counts, 50), ("HNN", -counts, 50)])
    with pytest.raises(RecordError, match="give units"):
        parse_motion("made", BINARY)
    east, north = parse_motion("made", BINARY, units="4.2e-7 m/s^2")
    assert (east.name, north.name) == ("made XX.STA..HNE", "made XX.STA..HNN")
    assert east.acceleration == pytest.approx(counts * 4.2e-7)
    assert dict(east.attribution)["station"] == "STA"


def test_gaps_and_damage_in_binary_files_are_refused(monkeypatch):
    counts = np.arange(50, dtype=np.int32)
    fake_obspy(monkeypatch, [("HNE", counts, 50), ("HNE", counts, 50)])
    with pytest.raises(RecordError, match="gaps"):
        parse_motion("made", BINARY, units="g")
    fake_obspy(monkeypatch, [("HNE", counts, 51)])
    with pytest.raises(RecordError, match="50 samples"):
        parse_motion("made", BINARY, units="g")
    fake_obspy(monkeypatch, error=KeyError("block 7"))
    with pytest.raises(RecordError, match="KeyError"):
        parse_motion("made", BINARY, units="g")
    fake_obspy(monkeypatch)
    with pytest.raises(RecordError, match="0 traces"):
        parse_motion("made", BINARY, units="g")


# --- files damaged at random ---------------------------------------------------------------------


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
}
STEP_IS_FREE = {"at2", "at2 new", "csv", "csv counted", "embedded"}  # said once, or by the times


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
        self.touched = 16
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
    # A line of another block, of velocities, is as legal there: volume 2 is left to the count below.
    if damage.kind == "swap lines" and name != "v2":
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
        for end in range(0, len(data), 1 if name in ("at2", "embedded") else 7):
            try:
                records = parse_motion(name, data[:end])
            except RecordError:
                continue
            assert [r.acceleration.tobytes() for r in records] == [
                r.acceleration.tobytes() for r in right
            ]
