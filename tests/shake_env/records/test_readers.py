"""Readers of recorded motions: every format, what they refuse and how, and files damaged at random."""

import sys
import types

import numpy as np
import pytest
from record_texts import (
    CICLC,
    at2_text,
    csv_text,
    fortran,
    knet_counts,
    knet_text,
    only,
    v1_channel,
    v1_text,
    v2_channel,
    v2_text,
    wave,
)

from shake_env.errors import FileError, RecordError
from shake_env.model.parameters import GRAVITY
from shake_env.records import RECORD_NAMES, Record, load_record, parse_motion, read_motion, write_record


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
    rows = ["-12.34567-23.45678" * 4, "-12.34567-23.45678" * 2]
    record = only("\n".join([*head, *rows]) + "\n")
    assert np.array_equal(record.acceleration, np.array([-12.34567, -23.45678] * 6) * GRAVITY)


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
    for scale in (1e-300, 1e-9, 1.0, 2e2):
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
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError, match="where a folder is needed"):
        write_record(load_record(RECORD_NAMES[0]), tmp_path / "file" / "made.csv")


BINARY = b"000001D \0\0\0\0" * 20


def test_binary_files_name_the_missing_package(monkeypatch):
    monkeypatch.setitem(sys.modules, "obspy", None)
    with pytest.raises(RecordError, match=r"pip install '.\[obspy\]'"):
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
