"""Structures from files: MAT and CSV, damaged ones, and what is no file."""

import os

import numpy as np
import pytest
from scipy.io import savemat

from shake_env.errors import FileError, ParameterError
from shake_env.model.specimens import specimen_from_matrices
from shake_env.records import read_specimen

M = np.diag([40.0, 30.0, 20.0])
K = np.array([[9.0e4, -4.0e4, 5.0e3], [-4.0e4, 7.0e4, -2.5e4], [5.0e3, -2.5e4, 2.2e4]])
RAYLEIGH = ((2.0, 0.03), (8.0, 0.04))
FRAME = specimen_from_matrices(M, K, rayleigh=RAYLEIGH)


def text(**matrices):
    lines = ["# a frame"]
    for name, matrix in matrices.items():
        lines += [name, *(",".join(repr(float(v)) for v in row) for row in matrix)]
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("compressed", [False, True])
def test_a_mat_file_gives_the_structure(tmp_path, compressed):
    file = tmp_path / "frame.mat"
    savemat(file, {"M": M, "K": K, "c": FRAME.damping_matrix}, do_compression=compressed)
    assert read_specimen(file) == FRAME


def test_a_csv_file_gives_the_structure(tmp_path):
    file = tmp_path / "frame.csv"
    file.write_text(text(M=M, K=K))
    assert read_specimen(file, rayleigh=RAYLEIGH) == FRAME


@pytest.mark.parametrize(
    ("content", "what"),
    [
        (text(M=M, X=K), "line 6 is no row of finite numbers"),
        (text(M=M), "no matrix K"),
        ("1,2\n", "line 1 stands before the name"),
        (text(M=M, K=K).replace("90000.0", "nan"), "line 7 is no row"),
        (text(M=M, K=K).replace("90000.0", "1e400"), "line 7 is no row"),
        ("M\n\xff\n", "cannot be read"),
        ("", "no matrix M"),
    ],
)
def test_a_damaged_csv_file_is_refused(tmp_path, content, what):
    file = tmp_path / "frame.csv"
    file.write_bytes(content.encode("latin-1"))
    with pytest.raises(FileError, match=what):
        read_specimen(file, damping_ratio=0.02)


def test_what_is_no_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.csv")
    for place in (tmp_path / "pipe.csv", tmp_path, tmp_path / "none.mat", "/dev/zero"):
        with pytest.raises(FileError, match="cannot be read"):
            read_specimen(place)


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("number", [100, pytest.param(2_000, marks=pytest.mark.slow)])
def test_damaged_mat_files_give_the_structure_or_an_error(tmp_path, compressed, number):
    """`scipy.io.loadmat` ends the interpreter on some of these."""
    whole, file = tmp_path / "whole.mat", tmp_path / "frame.mat"
    savemat(whole, {"M": M, "K": K, "C": FRAME.damping_matrix}, do_compression=compressed)
    data, r = whole.read_bytes(), np.random.default_rng(0)
    refused = 0
    for _ in range(number):
        changed = bytearray(data[: r.integers(1, len(data) + 1)] if r.random() < 0.3 else data)
        for place in r.integers(0, len(changed), 4):
            changed[place] = r.integers(0, 256)
        file.write_bytes(bytes(changed))
        try:
            read_specimen(file)
        except (FileError, ParameterError):
            refused += 1
    assert refused > number / 3
