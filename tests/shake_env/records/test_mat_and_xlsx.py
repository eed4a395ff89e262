"""MATLAB's files and workbooks: which variable, sheet and column is read, and what is refused."""

import io
import sys
import zlib

import numpy as np
import pytest
import scipy.io
from record_texts import wave

from shake_env.errors import ParameterError, RecordError
from shake_env.model.parameters import GRAVITY
from shake_env.records import parse_motion, read_motion

ACC = wave(60)
TIME = 0.005 * np.arange(60)


def mat(compressed=False, **variables):
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables, do_compression=compressed)
    return stream.getvalue()


def only(data, **options):
    (record,) = parse_motion("made", data, **options)
    return record


# --- .mat ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variables", "options"),
    [
        ({"t": TIME, "acc": ACC, "units": "g"}, {}),
        ({"t": TIME[:, None], "acc": ACC[:, None]}, {"units": "g"}),
        ({"acc": ACC, "dt": 0.005, "units": "g"}, {}),
        ({"acc": ACC, "fs": 200, "units": "g"}, {}),
        ({"signal": ACC}, {"units": "g", "sampling_interval": 0.005}),
        ({"data": np.column_stack([TIME, ACC])}, {"units": "g"}),
        ({"data": np.vstack([TIME, ACC])}, {"units": "g"}),
        ({"eq": {"time": TIME, "acc": ACC, "units": "g", "name": "made up"}}, {}),
        ({"t": TIME, "acc": ACC, "vel": ACC / 20, "disp": ACC / 300}, {"units": "g"}),
        ({"acc": ACC, "other": np.ones(7), "dt": 0.005}, {"units": "g", "table": "acc"}),
    ],
)
def test_mat_files_as_laboratories_write_them(variables, options):
    record = only(mat(**variables), **options)
    assert record.acceleration == pytest.approx(ACC * GRAVITY, rel=1e-15)
    assert record.sampling_interval == pytest.approx(0.005, rel=1e-12)
    assert dict(record.attribution)["format"].startswith("MATLAB 5, ")


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8"])
def test_mat_numbers_of_every_kind_are_those_that_scipy_reads(kind, compressed):
    values = np.arange(60).astype(kind)
    data = mat(compressed, acc=values, empty=np.empty(0), text="made up", cell=np.array(["a"], object))
    theirs = scipy.io.loadmat(io.BytesIO(data))["acc"].ravel().astype(float)
    record = only(data, units="0.001 g", sampling_interval=0.005)
    assert record.acceleration == pytest.approx(theirs * 0.001 * GRAVITY, rel=1e-14)


def test_mat_says_what_it_did_not_read():
    record = only(mat(t=TIME, acc=ACC, other=np.ones(7), dt=0.005), units="g", table="acc")
    assert dict(record.attribution)["not read"] == "other"
    record = only(mat(t=TIME, acc=ACC, vel=ACC), units="g")
    assert "velocity, skipped" in dict(record.attribution)["columns read as"]


def test_mat_gives_every_column_of_acceleration_or_the_one_asked():
    data = mat(t=TIME, acc_n=ACC, acc_e=-ACC)
    north, east = parse_motion("made", data, units="g")
    assert np.array_equal(north.acceleration, -east.acceleration)
    assert (north.name, east.name) == ("made acc_n", "made acc_e")
    assert only(data, units="g", column="acc_e").digest == east.digest
    both = parse_motion("made", mat(acc=np.column_stack([ACC, -ACC]), dt=0.005), units="g")
    assert [r.name for r in both] == ["made acc(1)", "made acc(2)"]


@pytest.mark.parametrize(
    ("data", "options", "match"),
    [
        (mat(acc=ACC, dt=0.005), {}, "give units"),
        (mat(acc=ACC), {"units": "g"}, "give sampling_interval"),
        (mat(acc=ACC, dt=-1.0), {"units": "g"}, "above 0"),
        (mat(acc=ACC, dt=0.005, units="g"), {"units": "m/s^2"}, "differs from the given m/s"),
        (mat(t=TIME, acc=ACC, dt=0.02), {"units": "g"}, "differs"),
        (mat(a=ACC, b=ACC[:50], dt=0.005), {"units": "g"}, r"several lengths: choose one.*--sheet"),
        (mat(a=ACC, dt=0.005), {"units": "g", "table": "z"}, r"no variable of numbers.*a \(60, 1\)"),
        (mat(name="made up", dt=0.005), {"units": "g"}, "must hold a vector"),
        (mat(a=ACC * 1j, dt=0.005), {"units": "g"}, "must hold a vector"),
        (mat(vel=ACC, dt=0.005), {"units": "g"}, "none of the columns is an acceleration"),
        (mat(a=np.where(ACC[9] == ACC, np.nan, ACC), dt=0.005), {"units": "g"}, "sample 9.*finite"),
        (mat(acc=ACC)[:-40], {"units": "g"}, "the MAT-file is damaged"),
    ],
    # A MAT-file says when it was written: its bytes would be another name in each process.
    ids=lambda value: "file" if isinstance(value, bytes) else None,
)
def test_mat_files_that_do_not_fit_are_refused(data, options, match):
    with pytest.raises(RecordError, match=match):
        parse_motion("made", data, **options)


def test_damaged_mat_files_raise_record_errors():
    rng = np.random.default_rng(0)
    read = 0
    for trial in range(300):
        data = mat(trial % 2 == 0, t=TIME, acc=ACC, eq={"acc": ACC}, units="g")
        damaged = bytearray(data[: rng.integers(200, len(data))] if trial % 3 else data)
        for place in rng.integers(124, len(damaged), 3):
            damaged[place] = rng.integers(256)
        try:
            records = parse_motion("made", bytes(damaged), table="acc", allow_large=True)
        except RecordError:
            continue
        read += 1
        assert all(np.isfinite(record.acceleration).all() for record in records)
    assert 5 < read < 250  # neither all nor none are refused


def test_mat_of_a_huge_size_is_refused_before_it_is_read():
    data = mat(acc=np.zeros((2100, 2100)))
    with pytest.raises(RecordError, match=r"4410000 elements.*at most"):
        parse_motion("made", data, units="g")


def test_mat_that_unpacks_without_end_is_refused():
    data = bytearray(mat(acc=ACC))[:128]
    packed = zlib.compress(bytes(80_000_000))
    data += np.array([15, len(packed)], "<u4").tobytes() + packed
    with pytest.raises(RecordError, match="too large"):
        parse_motion("made", bytes(data), units="g")


def test_mat_7_3_is_refused_in_words_without_h5py(monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    data = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512, b" ") + b"\x89HDF\r\n\x1a\n" + bytes(99)
    with pytest.raises(RecordError, match=r"save\(\.\.\., '-v7'\)"):
        parse_motion("made", data, units="g")


def test_mat_7_3_through_h5py(tmp_path):
    h5py = pytest.importorskip("h5py", reason="h5py, which reads MATLAB 7.3, is not installed")
    path = tmp_path / "made.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("eq")  # as MATLAB writes it: transposed, text as codes
        for key, values in (("acc", ACC[None, :]), ("t", TIME[None, :])):
            group.create_dataset(key, data=values).attrs["MATLAB_class"] = np.bytes_("double")
        codes = np.array([[ord("g")]], dtype=np.uint16)
        group.create_dataset("units", data=codes).attrs["MATLAB_class"] = np.bytes_("char")
    with open(path, "r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file".ljust(124, b" "))
    (record,) = read_motion(path)
    assert record.acceleration == pytest.approx(ACC * GRAVITY, rel=1e-15)
    assert dict(record.attribution)["format"] == "MATLAB 7.3, eq.acc"
    with h5py.File(path, "a") as file:
        file["linked"] = h5py.ExternalLink("other.h5", "acc")
    with pytest.raises(RecordError, match=r"linked.*not followed"):
        read_motion(path)


# --- .xlsx ---------------------------------------------------------------------------------------


def workbook(sheets):
    openpyxl = pytest.importorskip("openpyxl", reason="the extra xlsx is not installed")
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def rows(titles, columns, above=()):
    return [*above, titles, *(list(map(float, row)) for row in zip(*columns, strict=True))]


PLAIN = rows(["Time (s)", "Acceleration (g)"], [TIME, ACC])


@pytest.mark.parametrize(
    ("sheets", "options"),
    [
        ({"Sheet1": PLAIN}, {}),
        ({"Sheet1": PLAIN, "empty": []}, {}),
        ({"notes": [["made up"], ["nobody"]], "data": PLAIN}, {"table": "data"}),
        ({"Sheet1": [[None, *row] for row in PLAIN]}, {}),
        (
            {"Sheet1": rows(["Time (s)", "Acceleration (g)"], [TIME, ACC], above=[["Made-up motion"]])},
            {},
        ),
        (
            {"Sheet1": rows(["t [s]", "acc [g]", "vel [m/s]"], [TIME, ACC, ACC])},
            {},
        ),
        ({"Sheet1": rows(["t [s]", "N [g]", "E [g]"], [TIME, ACC, -ACC])}, {"column": "N [g]"}),
    ],
)
def test_workbooks_as_laboratories_write_them(sheets, options):
    record = only(workbook(sheets), **options)
    assert record.acceleration == pytest.approx(ACC * GRAVITY, rel=1e-15)
    assert record.sampling_interval == pytest.approx(0.005, rel=1e-12)
    assert dict(record.attribution)["format"].startswith("workbook, sheet ")


def test_workbooks_that_do_not_fit_are_refused():
    with pytest.raises(RecordError, match=r"sheets: a, b.*--sheet"):
        parse_motion("made", workbook({"a": PLAIN, "b": PLAIN}))
    with pytest.raises(RecordError, match=r"c.*no filled sheet; there are: a"):
        parse_motion("made", workbook({"a": PLAIN}), table="c")
    with pytest.raises(RecordError, match="sheets: none"):
        parse_motion("made", workbook({"a": []}))
    holes = [list(row) for row in PLAIN]
    holes[7][1] = None
    with pytest.raises(RecordError, match="made, sheet a, line 8"):
        parse_motion("made", workbook({"a": holes}))
    with pytest.raises(RecordError, match="give units"):
        parse_motion("made", workbook({"a": rows(["Time (s)", "acc"], [TIME, ACC])}))
    data = workbook({"a": PLAIN})
    with pytest.raises(RecordError, match="openpyxl cannot read it"):
        parse_motion("made", data[: len(data) // 2] + b"xl/workbook.xml")


def test_workbooks_name_the_missing_package_and_the_older_format(monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl", None)
    with pytest.raises(RecordError, match=r"pip install '\.\[xlsx\]'"):
        parse_motion("made", b"PK\x03\x04 xl/workbook.xml")
    with pytest.raises(RecordError, match=r"save it as \.xlsx"):
        parse_motion("made", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(99))


def test_a_table_is_refused_where_there_is_none():
    with pytest.raises(ParameterError, match="which has no tables"):
        parse_motion("made", b"# units: g\n0,1\n0.1,1\n", table="acc")
