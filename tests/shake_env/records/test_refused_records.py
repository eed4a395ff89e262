"""What the readers of recorded motions refuse, and how."""

import math

import pytest
from record_texts import (
    AT2,
    CSV,
    KNET,
    V1,
    V2,
    at2_text,
    csv_text,
    knet_counts,
    knet_text,
    v1_channel,
    v2_channel,
    wave,
)

from shake_env.errors import ParameterError, RecordError
from shake_env.records import parse_motion, read_motion
from shake_env.records.motion_file import READERS


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


def test_an_unknown_file_names_every_format_that_was_tried():
    for content in (b"Dear all,\nplease find attached\n", b"# a comment\n"):
        with pytest.raises(RecordError, match="known formats") as refusal:
            parse_motion("made", content)
        assert all(reader.name in str(refusal.value) for reader in READERS)


@pytest.mark.parametrize("path", ["absent.at2", "\0", "."])
def test_a_file_that_cannot_be_read_is_a_record_error(path, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RecordError, match="can be read"):
        read_motion(path)
