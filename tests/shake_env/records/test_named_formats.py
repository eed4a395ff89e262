"""ESM, COSMOS, SMC, AFAD, GeoNet, CWA, CDMG: read right, or refused by line and value; seismometers."""

import contextlib
import sys
import time
import tracemalloc
import types

import numpy as np
import pytest
from format_texts import (
    DECIMAL,
    EVEN,
    FORMATS,
    STEP,
    TIMES,
    VALUES,
    afad_text,
    cdmg_volume_1,
    cdmg_volume_2,
    cosmos_text,
    cwa_text,
    esm_text,
    geonet_component,
    geonet_text,
    smc_text,
)
from record_texts import only, wave

from shake_env.errors import RecordError
from shake_env.model.parameters import GRAVITY
from shake_env.records import parse_motion, read_motion

RIGHT = {
    "esm": [VALUES / 100.0],
    "cosmos": [VALUES / 100.0],
    "smc": [VALUES / 100.0],
    "afad": [VALUES / 100.0, VALUES / 200.0, VALUES / 400.0],
    "geonet 1": [DECIMAL / 1000.0, -DECIMAL / 1000.0, -DECIMAL / 1000.0],
    "geonet 2": [DECIMAL / 1000.0, -DECIMAL / 1000.0, -DECIMAL / 1000.0],
    "cwa": [VALUES / 100.0, VALUES / 200.0, -VALUES / 100.0],
    "cdmg 1": [EVEN * GRAVITY],
    "cdmg 2": [VALUES / 100.0],
}
PRINTED = {"smc": 5e-5, "cwa": 5.1e-6, "afad": 5.1e-9}  # what the printed digits take off [m/s^2]
NAMED = {
    "esm": "ESM, ITACA ASCII",
    "cosmos": "COSMOS volume 2, corrected",
    "smc": "SMC, 2, corrected",
    "afad": "AFAD ASCII",
    "geonet 1": "GeoNet volume 1",
    "geonet 2": "GeoNet volume 2",
    "cwa": "CWA, CWB ASCII",
    "cdmg 1": "CDMG, Caltech volume 1",
    "cdmg 2": "CDMG, Caltech volume 2",
}


@pytest.mark.parametrize("name", FORMATS)
def test_each_format_gives_its_accelerations_and_names_its_reader(name):
    text = FORMATS[name]
    for form in (text, text.replace("\n", "\r\n"), text.replace("\n", "  \n")):
        records = parse_motion("made", form.encode())
        for record, right in zip(records, RIGHT[name], strict=True):
            assert record.acceleration == pytest.approx(right, rel=1e-15, abs=PRINTED.get(name, 0.0))
            assert record.sampling_interval == STEP
            assert dict(record.attribution)["format"] == NAMED[name]


def test_velocity_and_displacement_are_skipped_and_named():
    both = (
        cosmos_text(VALUES)
        + cosmos_text(VALUES / 20, kind="velocity", unit="cm/sec", code=5)
        + cosmos_text(VALUES / 300, kind="displacement", unit="cm", code=6)
    )
    assert dict(only(both).attribution)["not read"] == "velocity, displacement"
    assert np.array_equal(only(both).acceleration, VALUES / 100.0)
    for name in ("geonet 2", "cdmg 2"):
        record = parse_motion("made", FORMATS[name].encode())[0]
        assert dict(record.attribution)["not read"] == "velocity, displacement"


def test_cosmos_channels_units_forms_and_counts():
    three = "".join(
        cosmos_text(VALUES + k, number=k, channels="( 3 Chns of  3 at Sta)") for k in (1, 2, 3)
    )
    records = parse_motion("made", three.encode())
    assert [record.name for record in records] == [f"made channel {k} ({90 * k} deg)" for k in (1, 2, 3)]
    assert records[2].acceleration == pytest.approx((VALUES + 3) / 100.0, rel=1e-12)
    fine = only(cosmos_text(VALUES, form="1E15.6"))
    assert fine.acceleration == pytest.approx(VALUES / 100.0, rel=1e-6)
    in_g = only(cosmos_text(np.round(VALUES / 100, 5), unit="g", code=2, stage=1))
    assert np.array_equal(in_g.acceleration, np.round(VALUES / 100, 5) * GRAVITY)
    counts = np.round(1e4 * VALUES).astype(int) - 2_000_000  # touching columns
    raw = cosmos_text(counts, unit="counts", code=50, stage=0, form="10I8")
    with pytest.raises(RecordError, match=r"line 48.*give units"):
        parse_motion("made", raw.encode())
    assert np.array_equal(only(raw, units="4.2e-7 m/s^2").acceleration, counts * 4.2e-7)


def test_digitized_points_at_uneven_times_are_interpolated_at_a_given_step():
    times = np.round(TIMES + 0.004 * np.sin(np.arange(43)), 3)
    text = cdmg_volume_1(EVEN, times, length=times[-1])
    with pytest.raises(RecordError, match=r"uneven times: give sampling_interval"):
        parse_motion("made", text.encode())
    record = only(text, sampling_interval=0.005)
    assert record.sampling_interval == 0.005
    grid = 0.005 * np.arange(len(record.acceleration))
    right = np.interp(grid, times - times[0], EVEN * GRAVITY)
    assert record.acceleration == pytest.approx(right, abs=1e-12)
    assert "43 points at uneven times" in dict(record.attribution)["interpolated"]
    with pytest.raises(RecordError, match="must not be above the points' own"):
        parse_motion("made", text.encode(), sampling_interval=0.02)


def test_caltech_volume_1_has_a_wider_first_column():
    text = cdmg_volume_1(EVEN, TIMES, wide=True)
    assert only(text).acceleration == pytest.approx(EVEN * GRAVITY, rel=1e-14)


def test_units_of_a_file_stand_against_the_caller():
    for text in (FORMATS["esm"], FORMATS["smc"], FORMATS["cosmos"], FORMATS["cwa"], FORMATS["cdmg 2"]):
        assert parse_motion("made", text.encode(), units="gal")
        with pytest.raises(RecordError, match="differs from the given g"):
            parse_motion("made", text.encode(), units="g")
        with pytest.raises(RecordError, match=r"differs from the given 0\.02 s"):
            parse_motion("made", text.encode(), sampling_interval=0.02)


# --- what is refused, and how --------------------------------------------------------------------


def changed(name, old, new, count=1):
    assert old in FORMATS[name]
    return FORMATS[name].replace(old, new, count)


REFUSED = {
    "esm count": (esm_text(VALUES, NDATA=44), "line 8", "NDATA 44"),
    "esm step": (esm_text(VALUES, SAMPLING_INTERVAL_S="0.02"), "line 9", "length 0.43"),
    "esm no step": (esm_text(VALUES, SAMPLING_INTERVAL_S=""), "line 7", "seconds"),
    "esm unit": (esm_text(VALUES, unit="furlong"), "line 11", "furlong"),
    "esm other unit": (esm_text(VALUES, unit="m/s^2"), "line 12", "peak"),
    "esm peak": (esm_text(VALUES, **{"PGA_CM/S^2": "99.0"}), "line 12", "peak 99.0"),
    "esm velocity": (esm_text(VALUES, kind="VELOCITY"), "line 14", "no acceleration"),
    "esm spectrum": (esm_text(VALUES, kind="ACCELERATION RESPONSE SPECTRUM"), "line 14", "SPECTRUM"),
    "esm twice": (changed("esm", "USER5", "STREAM"), "line 15", "again"),
    "esm two columns": (changed("esm", "\n3.295000", "\n3.29 3.30"), "line", "expected 1"),
    "cosmos velocity only": (
        cosmos_text(VALUES, kind="velocity", unit="cm/sec", code=5),
        "made", "velocity",
    ),
    "cosmos count": (
        changed("cosmos", "      43 acceleration", "      44 acceleration"),
        "line", "field 4",
    ),
    "cosmos count below": (
        changed("cosmos", "      43 acceleration", "      41 acceleration"),
        "line", "more than 41",
    ),
    "cosmos peak": (cosmos_text(VALUES, peak=99.0), "line 26", "peak 99"),
    "cosmos unit": (cosmos_text(VALUES, unit="g"), "line", "cm/s^2"),
    "cosmos format": (changed("cosmos", "Format=(8F10.5)", "Format=(8"), "line", "8F10.5"),
    "cosmos comments": (changed("cosmos", "   1 Comment", "   9 Comment"), "line", "comment"),
    "cosmos integers": (changed("cosmos", " 100 Integer", "  10 Integer"), "line 14", "10 values"),
    "cosmos channels": (
        cosmos_text(VALUES, channels="( 3 Chns of 3 at Sta)") + cosmos_text(VALUES, number=2),
        "line 7", "3 Chns",
    ),
    "cosmos channel twice": (cosmos_text(VALUES) * 2, "line", "twice"),
    "cosmos second integer": (
        cosmos_text(VALUES).replace("       2       1 ", "       2       2 "),
        "line", "veloc",
    ),
    "smc count": (smc_text(VALUES, points=44), "line", "field 4"),
    "smc count below": (smc_text(VALUES, points=40), "line 34", "more than 40"),
    "smc extremes": (smc_text(VALUES, extremes=(99.0, -9.0)), "line 23", "peak 99"),
    "smc text's peak": (changed("smc", "pk acc =", "pk acc = 9"), "line 7", "peak 9"),
    "smc rate": (smc_text(VALUES, rate=1e9), "line 18", "sampling_interval"),
    "smc velocity": (smc_text(VALUES, title="3 VELOCITY"), "line 1", "no acceleration"),
    "smc comments": (changed("smc", "|made up", " made up"), "line 13", "comment"),
    "afad count": (afad_text(VALUES, points=44), "line 13", "NUMBER OF DATA 44"),
    "afad peak": (afad_text(VALUES, **{"E-W": 99.0}), "line 15", "peak 99"),
    "afad titles": (changed("afad", "       N-S          E-W          U-D\n", ""), "line 1", "N-S"),
    "afad unit": (changed("afad", "(gal)", "(gel)"), "line 15", "gel"),
    "geonet count": (geonet_text(DECIMAL, points=44), "line 20", "44"),
    "geonet peak": (geonet_text(DECIMAL, peak="99.0"), "line 14", "peak 99"),
    "geonet step": (
        changed("geonet 1", "at intervals of 0.010", "at intervals of 0.011"),
        "line", "0.01",
    ),
    "geonet scale": (changed("geonet 1", "units of 1.00", "units of 2.00"), "line 11", "1.00"),
    "geonet two components": (
        geonet_component(DECIMAL) + geonet_component(DECIMAL, "Up"),
        "line 1", "2 components",
    ),
    "geonet twice": (geonet_component(DECIMAL) * 3, "line", "twice"),
    "geonet more": (FORMATS["geonet 1"] + "   1.0\n", "line", "no next component"),
    "cwa length": (cwa_text(VALUES, length=9), "line 15", "length 9"),
    "cwa rate": (cwa_text(VALUES, rate=50), "line", ""),
    "cwa peak": (cwa_text(VALUES, N="    9.000~   -9.000"), "line 19", "9.000~"),
    "cwa order": (changed("cwa", "Time U(+); N(+)", "Time U(+)"), "line 21", "Time U(+); N(+); E(+)"),
    "cwa sign": (changed("cwa", "N(+)", "N(-)"), "line 21", "Time U(+); N(+); E(+)"),
    "cwa unit": (changed("cwa", "gal.", "gel."), "line 17", "gel"),
    "cwa times": (changed("cwa", "     0.020", "     0.025"), "line 25", "evenly"),
    "cdmg peak": (cdmg_volume_1(EVEN, TIMES, peak=".999"), "line 5", "peak .999"),
    "cdmg scale": (changed("cdmg 1", "G/10", "G"), "line 5", "peak"),
    "cdmg rms": (cdmg_volume_1(EVEN, TIMES, rms=0.9), "line 6", "root mean square"),
    "cdmg length": (cdmg_volume_1(EVEN, TIMES, length=9.0), "line 4", "length 9"),
    "cdmg count": (changed("cdmg 1", "POINTS =     43", "POINTS =     42"), "line", ""),
    "cdmg 2 peak": (cdmg_volume_2(VALUES, peak="99.0"), "line 6", "peak 99.0"),
    "cdmg 2 velocity": (
        changed("cdmg 2", "PEAK VELOCITY = 1.43", "PEAK VELOCITY = 9.43"),
        "line 7", "9.43",
    ),
    "cdmg 2 count": (changed("cdmg 2", "43 INSTRUMENT", "48 INSTRUMENT"), "line", ""),
    "cdmg 2 step": (changed("cdmg 2", "  0.01 SEC", "  zero SEC"), "line 5", "zero"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_by_line_and_value(case):
    text, place, value = REFUSED[case]
    with pytest.raises(RecordError) as caught:
        parse_motion("made", text.encode())
    assert caught.value.field.startswith("made") and place in caught.value.field
    assert value in str(caught.value)
    assert caught.value.remedy


# --- seismometers --------------------------------------------------------------------------------


SEISMOMETERS = [
    ("HHE", esm_text(VALUES, stream="HHE")),
    ("BHN", cosmos_text(VALUES, scnl="BHN")),
    ("EHZ", smc_text(VALUES, component="EHZ")),
    ("type 138", smc_text(VALUES, sensor=138)),
]


@pytest.mark.parametrize(("code", "text"), SEISMOMETERS)
def test_channels_of_seismometers_are_refused_unless_allowed(code, text):
    with pytest.raises(RecordError, match=rf"{code}.*measures velocity.*--allow-seismometers"):
        parse_motion("made", text.encode())
    (record,) = parse_motion("made", text.encode(), allow_seismometers=True)
    assert np.max(np.abs(record.acceleration)) == pytest.approx(0.28695, rel=1e-4)


def test_accelerometers_are_read():
    for text in (esm_text(VALUES, stream="HNE"), cosmos_text(VALUES, scnl="HNZ"), smc_text(VALUES)):
        assert only(text)


def test_binary_channels_of_seismometers_are_refused_unless_allowed(monkeypatch):
    def stats(channel):
        return types.SimpleNamespace(
            npts=50, delta=0.01, network="XX", station="STA", channel=channel, starttime=0,
            get=lambda key, default=None: default,
        )  # fmt: skip

    class Stats(types.SimpleNamespace):
        def __contains__(self, key):
            return hasattr(self, key)

    def trace(channel):
        return types.SimpleNamespace(
            id=f"XX.STA..{channel}", data=np.arange(50, dtype=np.int32),
            stats=Stats(**vars(stats(channel))),
        )  # fmt: skip

    for channel in ("HHE", "BHZ", "EHN", "DPZ"):
        read = types.SimpleNamespace(read=lambda _, channel=channel: [trace(channel)])
        monkeypatch.setitem(sys.modules, "obspy", read)
        data = b"000001D \0\0\0\0" * 20
        with pytest.raises(RecordError, match=f"channel {channel}.*measures velocity"):
            parse_motion("made", data, units="0.01 m/s^2")
        assert parse_motion("made", data, units="0.01 m/s^2", allow_seismometers=True)


@pytest.mark.filterwarnings("ignore")
def test_miniseed_of_obspy_itself(tmp_path):
    obspy = pytest.importorskip("obspy", reason="the extra obspy is not installed")
    for channel, refused in (("HHZ", True), ("HNZ", False)):
        header = {"network": "XX", "station": "AAA", "channel": channel, "delta": STEP}
        trace = obspy.Trace(np.round(1e3 * VALUES).astype(np.int32), header)
        trace.write(str(tmp_path / "made.mseed"), format="MSEED")
        options = {"units": "1e-5 m/s^2"}
        if refused:
            with pytest.raises(RecordError, match=r"channel HHZ.*measures velocity"):
                read_motion(tmp_path / "made.mseed", **options)
        (record,) = read_motion(tmp_path / "made.mseed", **options, allow_seismometers=refused)
        assert record.acceleration == pytest.approx(VALUES / 100.0)
        assert dict(record.attribution)["format"] == "MSEED"


# --- time and memory -----------------------------------------------------------------------------


def long_texts(points):
    values = np.round(100.0 * wave(points, scale=0.3), 3)
    return {
        "esm": esm_text(values),
        "cosmos": cosmos_text(values),
        "smc": smc_text(values),
        "afad": afad_text(values),
        "geonet 2": geonet_text(np.round(values, 1), volume=2),
        "cwa": cwa_text(values),
        "cdmg 2": cdmg_volume_2(values),
    }


def test_memory_is_at_most_six_times_the_file():
    for name, text in long_texts(25_000).items():
        data = text.encode()
        tracemalloc.start()
        try:
            parse_motion(name, data)
            peak = tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()
        assert peak <= 6 * len(data) + 2**20, f"{name}: {peak / len(data):.1f} times"


HEADS = {name: "\n".join(text.split("\n")[:30]) for name, text in FORMATS.items()}


@pytest.mark.parametrize("name", HEADS)
def test_time_of_long_and_repeated_lines_is_linear(name):
    def seconds(size):
        worst = 0.0
        for filler in (" ", "1", "-", "= ", "x:", "(", "MAX ", "\n", "|\n", "E+"):
            for at in (0, 5, 9, 14, 29):
                lines = FORMATS[name].split("\n")
                at = min(at, len(lines) - 2)
                lines[at:at] = [lines[at] + filler * (size // len(filler))]
                began = time.process_time()
                with contextlib.suppress(RecordError):
                    parse_motion("made", "\n".join(lines).encode())
                worst = max(worst, time.process_time() - began)
        return worst

    assert seconds(200_000) < 0.5  # 2.5 us a byte


# --- the files' own makers' other readers ---------------------------------------------------------


@pytest.mark.filterwarnings("ignore")
def test_gmprocess_reads_the_same_values(tmp_path):
    reader = pytest.importorskip(
        "gmprocess.io.read", reason="gmprocess, which reads these formats, is not installed"
    )
    for name in ("esm", "cosmos", "smc", "afad", "geonet 1", "geonet 2", "cwa"):
        path = tmp_path / f"{name}.txt"
        path.write_text(cosmos_text(VALUES) if name == "cosmos" else FORMATS[name])
        ours = read_motion(path)
        theirs = [trace for stream in reader.read_data(path) for trace in stream]
        assert len(ours) == len(theirs)
        for record, trace in zip(ours, theirs, strict=True):
            assert record.acceleration == pytest.approx(trace.data / 100.0, abs=1e-12)
            assert record.sampling_interval == pytest.approx(trace.stats.delta)
