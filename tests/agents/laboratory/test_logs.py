"""Logs: what is written reads back to the last bit; what is damaged or foreign is refused in words."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from made_logs import hdf5_of_matlab, laboratory_log, tdms_bytes

from agents.laboratory.logs.csv_file import csv_bytes
from agents.laboratory.logs.findings import channel_faults, require_sound
from agents.laboratory.logs.hdf5_file import hdf5_bytes
from agents.laboratory.logs.log_file import parse_log, read_log, write_log
from agents.laboratory.logs.mapping import ChannelSource, Mapped, read_mapping
from agents.laboratory.logs.matlab_file import matlab_bytes
from agents.laboratory.logs.test_log import TestLog, require_same_test
from shake_env.errors import LogError, RecordError, ShakeError
from shake_env.records.formats import hdf5
from shake_env.scenario.overrides import make_scenario

FORMATS = {"h5": hdf5_bytes, "mat": matlab_bytes, "csv": csv_bytes, "tdms": tdms_bytes}


@pytest.mark.parametrize("ending", FORMATS)
def test_every_format_reads_back_to_the_last_bit(ending):
    log = laboratory_log()
    again = parse_log(f"test.{ending}", FORMATS[ending](log))
    assert again.sha256 == log.sha256
    assert again.name == log.name
    assert again.scenario == log.scenario
    assert list(again.channels) == list(log.channels)


def test_a_log_holds_what_the_sensors_read():
    log = laboratory_log()
    assert log.sampling_interval == 0.005
    assert log.samples == 800
    noise = np.diff(log.channels["table_displacement"], n=4)  # smooth but for the noise
    rms = float(np.sqrt(np.mean(noise**2) / 70.0))  # sum of the squared binomials of order 4
    assert rms == pytest.approx(7.6e-5, rel=0.1)
    assert abs(log.channels["current"]).max() <= log.scenario.current_limit


def test_a_foreign_file_is_read_by_its_mapping(tmp_path):
    log = laboratory_log()
    text = "Time;LVDT [mm];Acc (g);i\n" + "\n".join(
        f"{t:.3f};{-1e3 * x:.9f};{a / 9.80665:.12g};{1e3 * u:.12g}"
        for t, x, a, u in zip(
            log.time,
            log.channels["table_displacement"],
            log.channels["table_acceleration"],
            log.channels["current"],
            strict=True,
        )
    )
    (tmp_path / "foreign.csv").write_text(text)
    (tmp_path / "map.toml").write_text(
        'schema = 1\n[time]\ncolumn = "Time"\n[channels.current]\ncolumn = "i"\nunit = "mA"\n'
        '[channels.target_acceleration]\ncolumn = "Acc"\n'
        '[channels.table_displacement]\ncolumn = "LVDT"\nfactor = -1.0\n'
    )
    mapping = read_mapping(tmp_path / "map.toml")
    again = read_log(tmp_path / "foreign.csv", mapping)
    assert again.sampling_interval == pytest.approx(0.005, rel=1e-9)
    for name, source in (
        ("table_displacement", "table_displacement"),
        ("current", "current"),
        ("target_acceleration", "table_acceleration"),
    ):
        np.testing.assert_allclose(again.channels[name], log.channels[source], rtol=1e-9, atol=2e-12)
    with pytest.raises(LogError, match="mapping file"):
        read_log(tmp_path / "foreign.csv")
    gap = text.splitlines()
    del gap[400:410]
    (tmp_path / "gap.csv").write_text("\n".join(gap))
    with pytest.raises(LogError, match="fill the gap"):
        read_log(tmp_path / "gap.csv", mapping)
    (tmp_path / "map.toml").write_text((tmp_path / "map.toml").read_text().replace('"mA"', '"kN"'))
    with pytest.raises(LogError, match="does not convert to A"):
        read_log(tmp_path / "foreign.csv", read_mapping(tmp_path / "map.toml"))


def test_matlab_of_version_7_3_is_read(tmp_path):
    log = laboratory_log()
    (tmp_path / "map.toml").write_text(
        'schema = 1\nsampling_interval = "5 ms"\n'
        + "".join(
            f'[channels.{name}]\ncolumn = "{name}"\nunit = "{unit}"\n'
            for name, unit in (
                ("current", "A"),
                ("target_acceleration", "m/s^2"),
                ("table_velocity", "m/s"),
            )
        )
    )
    again = parse_log("x.mat", hdf5_of_matlab(log), read_mapping(tmp_path / "map.toml"))
    assert np.array_equal(again.channels["table_velocity"], log.channels["table_velocity"])
    assert "7.3" in again.source


@pytest.mark.parametrize(
    "text",
    [
        "schema = 2",
        "schema = 1\n[channels.nothing]\ncolumn = 'a'",
        "schema = 1\n[channels.current]\nunit = 'A'",
        "schema = 1\n[channels.current]\ncolumn = 'a'\nfactor = 'x'",
        "schema = 1\nsampling_interval = '5 kg'\n[channels.current]\ncolumn = 'a'",
        "schema = 1\nextra = 1\n[channels.current]\ncolumn = 'a'",
        "schema = ",
    ],
)
def test_a_wrong_mapping_is_refused(tmp_path, text):
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(LogError):
        read_mapping(tmp_path / "map.toml")


def changed(log, **channels):
    return replace(log, channels={**log.channels, **channels})


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (lambda v: v[:-1], "must hold 800 numbers"),
        (lambda v: np.where(np.arange(len(v)) == 7, np.nan, v), "sample 8"),
        (lambda v: v + 1e16, "below 1e"),
        (lambda v: v.astype(np.float32), "must hold"),
    ],
)
def test_a_channel_that_is_not_right_is_named(values, words):
    log = laboratory_log()
    with pytest.raises(LogError, match=words):
        changed(log, table_velocity=values(log.channels["table_velocity"]))


def test_faults_of_sensors_are_found_and_named():
    log = laboratory_log()
    assert channel_faults(log) == []
    velocity = log.channels["table_velocity"]
    stuck = velocity.copy()
    stuck[300:380] = stuck[300]
    limit = 0.6 * np.abs(velocity).max()
    for channels, kind in (
        ({"table_velocity": stuck}, "stuck"),
        ({"table_velocity": np.clip(velocity, -limit, limit)}, "saturated"),
        ({"table_velocity": np.zeros_like(velocity)}, "silent"),
    ):
        faulty = changed(log, **channels)
        assert [(f.channel, f.kind) for f in channel_faults(faulty)] == [("table_velocity", kind)]
        with pytest.raises(LogError, match=f"table_velocity is {kind}.*--without table_velocity"):
            require_sound(faulty)
        require_sound(faulty, without=["table_velocity"])


def test_a_log_of_another_table_or_rate_is_refused_in_words():
    log = laboratory_log()
    wanted = log.scenario
    for override, words in (
        ({"control_rate": 500.0}, "control_rate"),
        ({"fields": {"actuator.piston_area": 0.003}}, "actuator.piston_area"),
        ({"fields": {"sensing.sensors.load_pressure": None}}, "sensing.sensors"),
    ):
        other = make_scenario("laboratory", override)
        with pytest.raises(LogError, match=words):
            require_same_test(other, wanted, log.name)
    require_same_test(log.scenario, wanted, log.name)


def test_the_text_of_a_scenario_must_be_that_of_its_digest():
    log = laboratory_log()
    with pytest.raises(LogError, match="digest"):
        replace(log, digest="1:00")
    with pytest.raises(LogError, match="scenario"):
        replace(log, scenario_text="{}")


def mutated(content: bytes, rng: np.random.Generator) -> bytes:
    """A damaged copy: bytes changed, cut, repeated or left out, most often near the start."""
    data = bytearray(content)
    kind = rng.integers(5)
    at = int(len(data) * rng.random() ** 3)
    if kind == 0:
        data[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        for place in (len(data) * rng.random(8) ** 3).astype(int):
            data[place] = int(rng.integers(256))
    elif kind == 2:
        del data[at:]
    elif kind == 3:
        del data[at : at + int(rng.integers(1, 64))]
    else:
        data[at:at] = data[at : at + int(rng.integers(1, 64))]
    return bytes(data)


def check_mutations(number: int, seed: int) -> dict[str, int]:
    log = laboratory_log()
    short = replace(log, channels={k: v[:64].copy() for k, v in log.channels.items()})
    rng = np.random.default_rng(seed)
    contents = [(ending, write(short)) for ending, write in FORMATS.items()]
    count = {"right": 0, "refused": 0}
    for i in range(number):
        ending, content = contents[i % len(contents)]
        try:
            again = parse_log(f"x.{ending}", mutated(content, rng))
        except ShakeError:
            count["refused"] += 1
            continue
        assert again.sha256 == short.sha256, (ending, i)
        count["right"] += 1
    return count


def check_foreign_mutations(number: int, seed: int) -> int:
    """Foreign HDF5 files have no digest: what is read of a damaged one is a log or a typed error."""
    log = laboratory_log()
    short = replace(log, channels={k: v[:64].copy() for k, v in log.channels.items()})
    content, rng, refused = hdf5_of_matlab(short), np.random.default_rng(seed), 0
    names = ("current", "target_acceleration", "table_velocity")
    units = ("A", "m/s^2", "m/s")
    sources = {n: ChannelSource(column=n, unit=u) for n, u in zip(names, units, strict=True)}
    mapping = Mapped(channels=sources, sampling_interval=0.005)
    for _ in range(number):
        damaged = content[:512] + mutated(content[512:], rng)
        try:
            again = parse_log("x.mat", damaged, mapping)
        except ShakeError:
            refused += 1
            continue
        assert set(again.channels) == set(names)
    return refused


def test_mutated_foreign_logs_are_read_or_refused():
    assert check_foreign_mutations(6, 1) > 0


@pytest.mark.slow
def test_three_hundred_mutated_foreign_logs_are_read_or_refused():
    assert check_foreign_mutations(300, 2) > 100


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ("while True: pass", "not read by then"),
        ("import os; os.abort()", "ended by signal 6"),
        ("import sys; sys.exit('OSError: no such object')", "no such object"),
    ],
)
def test_a_file_that_stops_the_library_is_refused(program, words, tmp_path, monkeypatch):
    child = tmp_path / "child.py"
    child.write_text(program)
    monkeypatch.setattr(hdf5, "_CHILD", child)
    monkeypatch.setattr(hdf5, "WAITING", 1)
    with pytest.raises(RecordError, match=words):
        hdf5.hdf5_items("x.h5", b"", most=10, columns=10, depth=2, seconds=1)


def test_the_child_that_reads_has_a_limit_on_its_processor_time():
    code = "import runpy, sys; m = runpy.run_path(sys.argv[1]); m['_limit'](1)\nwhile True: pass"
    run = subprocess.run([sys.executable, "-I", "-c", code, str(hdf5._CHILD)], timeout=120, check=False)
    assert run.returncode < 0


def test_mutated_logs_are_right_or_refused():
    assert check_mutations(600, 1)["refused"] > 300


@pytest.mark.slow
def test_twenty_thousand_mutated_logs_are_right_or_refused():
    assert check_mutations(20_000, 2)["refused"] > 10_000


def test_a_log_is_written_by_the_ending_of_its_name(tmp_path):
    log = laboratory_log()
    for ending in ("h5", "mat", "csv"):
        write_log(log, tmp_path / f"a.{ending}")
        assert read_log(tmp_path / f"a.{ending}").sha256 == log.sha256
    with pytest.raises(LogError, match="must end in"):
        write_log(log, tmp_path / "a.txt")
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "missing.h5")


def test_a_log_needs_its_commands_and_a_measured_channel():
    with pytest.raises(LogError, match="must hold current"):
        TestLog("x", 0.005, {"target_acceleration": np.zeros(80)})
    with pytest.raises(LogError, match="measured"):
        TestLog("x", 0.005, {"target_acceleration": np.zeros(80), "current": np.zeros(80)})


def test_compare_writes_the_log_of_every_test(tmp_path):
    from rich.console import Console

    from agents.cli.commands import parse

    line = (
        "compare --scenario laboratory --duration 2 --controllers none --num-noise-motions 1 "
        f"--no-records --quiet --output {tmp_path / 'out'} --logs {tmp_path / 'logs'}"
    )
    parse(line.split()).run(Console(quiet=True))
    files = sorted(file.name for file in (tmp_path / "logs").iterdir())
    assert len(files) == 2  # the reference, too
    log = read_log(tmp_path / "logs" / files[1])
    assert log.name.startswith("none")
    assert not log.channels["current"].any()
