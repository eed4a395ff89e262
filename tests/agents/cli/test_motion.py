"""`shake motion` and `shake compare --motion`, as a shell user and a program meet them."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from agents.__main__ import main
from agents.motions.figure import COLUMNS, _outline
from agents.motions.intensity import arias_intensity, significant_duration
from shake_env import RecordedMotion, load_record
from shake_env.model.parameters import GRAVITY
from shake_env.motion.processing import fit_amplitude, fit_time
from shake_env.records import read_motion

CICLC = Path(__file__).parents[2] / "data" / "CICLC_trimmed.v1"


def run_json(capsys, *arguments):
    assert main([*map(str, arguments), "--json"]) == 0
    out, err = capsys.readouterr()
    return json.loads(out), err


def test_motion_prints_one_json_object_with_every_channel(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    found, err = run_json(capsys, "motion", CICLC)
    assert err == "" and list(tmp_path.iterdir()) == []
    records = read_motion(CICLC)
    assert len(found["channels"]) == 3
    for channel, record in zip(found["channels"], records, strict=True):
        motion = RecordedMotion(record=record, highpass_frequency=0.2, lowpass_frequency=25.0)
        amplitude, time = fit_amplitude(motion), fit_time(motion)
        assert channel["name"] == record.name
        assert channel["points"] == 800
        assert channel["sampling_interval"] == 0.01
        assert channel["peak_acceleration"] == np.max(np.abs(record.acceleration))
        assert channel["arias_intensity"] == arias_intensity(record)
        assert channel["significant_duration"] == significant_duration(record)
        assert channel["amplitude_scale"] == amplitude.factor
        assert channel["time_scale"] == time.factor
        assert channel["amplitude_governed_by"] == amplitude.governed_by
        assert "China Lake" in " ".join(channel["attribution"].values())
    peaks = [channel["peak_acceleration"] / GRAVITY for channel in found["channels"]]
    assert peaks == pytest.approx([0.344250, 0.510799, 0.347089], abs=1e-6)


def test_motion_for_a_person_says_scale_and_reason_and_draws(capsys, tmp_path):
    assert main(["motion", str(CICLC), "--output", str(tmp_path / "out")]) == 0
    out = capsys.readouterr().out
    scale = fit_amplitude(
        RecordedMotion(record=read_motion(CICLC)[1], highpass_frequency=0.2, lowpass_frequency=25.0)
    )
    for expected in ("CSMIP volume 1, 3 channels", "channel 2", "5.009", "70 mm", f"{scale.factor:.4g}",
                     f"{1e3 * scale.before.displacement:.3g} mm"):  # fmt: skip
        assert expected in out
    assert (tmp_path / "out" / "CICLC_trimmed.v1.png").stat().st_size > 20_000
    assert (tmp_path / "out" / "CICLC_trimmed.v1.svg").stat().st_size > 20_000


def test_motion_takes_units_limits_and_offset_from_the_command(capsys, tmp_path):
    path = tmp_path / "mine.txt"
    time = 0.01 * np.arange(2000)
    values = 0.05 + 0.3 * np.sin(6.0 * time) * np.exp(-(((time - 10.0) / 3.0) ** 2))
    path.write_text("".join(f"{t:.2f} {v:.6f}\n" for t, v in zip(time, values, strict=True)))
    assert main(["motion", str(path)]) == 2
    assert "give units" in capsys.readouterr().err
    (channel,) = run_json(capsys, "motion", path, "--units", "g")[0]["channels"]
    assert channel["name"] == "mine"
    assert channel["offset"] == pytest.approx(0.05 * GRAVITY, rel=1e-2)
    assert main(["motion", str(path), "--units", "g", "--output", str(tmp_path)]) == 0
    assert "--remove-offset" in capsys.readouterr().out
    (plain,) = run_json(capsys, "motion", path, "--units", "g", "--remove-offset")[0]["channels"]
    assert abs(plain["offset"]) < 1e-12 < plain["arias_intensity"] < channel["arias_intensity"]
    options = ["--units", "g", "--stroke", "0.01", "--velocity", "9"]
    (small,) = run_json(capsys, "motion", path, *options)[0]["channels"]
    assert small["amplitude_governed_by"] == "displacement"
    assert small["peaks_scaled_by_amplitude"]["displacement"] == pytest.approx(0.01)
    assert small["amplitude_scale"] < channel["amplitude_scale"]


def sine_file(path, step=0.01, samples=2000):
    time = step * np.arange(samples)
    values = 0.3 * np.sin(6.0 * time) * np.exp(-(((time - 10.0) / 3.0) ** 2))
    path.write_text("".join(f"{t:.4f} {v:.6f}\n" for t, v in zip(time, values, strict=True)))
    return path


def test_motion_judges_the_table_of_the_scenario(capsys, tmp_path):
    path = sine_file(tmp_path / "mine.csv")

    def judged(*options):
        found = run_json(capsys, "motion", path, "--units", "g", *options)[0]
        return found["scenario"], found["capacity"], found["channels"][0]

    name, usual, channel = judged()
    assert name == "linear" and usual["acceleration"] is None and usual["displacement"] == 0.07
    name, laboratory, _ = judged("--scenario", "laboratory")
    assert name == "laboratory" and laboratory["acceleration"] == 49.0
    _, half, scaled = judged("--scenario", "laboratory", "--set", "limits.table_displacement=0.038")
    assert half["displacement"] == 0.035 and scaled["amplitude_scale"] < channel["amplitude_scale"]
    _, heavy, _ = judged("--mass-ratio", "3", "--set", "limits.load_pressure=7e6")
    assert heavy["moving_mass"] == 720.0 and heavy["force"] == pytest.approx(7e6 * 0.00237)
    _, slow, _ = judged("--current-limit", "0.01")
    assert slow["velocity"] == pytest.approx(0.01 * 5e-4 * 76.0 / 0.00237)
    _, own, limited = judged("--acceleration", "0.5", "--pressure", "1e6")
    assert own["acceleration"] == 0.5 and own["force"] == pytest.approx(2370.0)
    assert limited["amplitude_governed_by"] == "acceleration"
    assert limited["peaks_scaled_by_amplitude"]["acceleration"] == pytest.approx(0.5)
    assert not limited["time_scale_suffices"]
    _, uneven, _ = judged("--set", "specimen.masses=[60, 40, 20]")
    assert uneven["moving_mass"] == 300.0


def test_each_record_has_a_figure_of_its_own(tmp_path):
    for name in ("one.csv", "wei rd&.csv"):
        path = sine_file(tmp_path / name)
        assert main(["motion", str(path), "--units", "g", "--output", str(tmp_path / "out")]) == 0
    names = {path.name for path in (tmp_path / "out").glob("*.png")}
    assert names == {"one.csv.png", "wei_rd_.csv.png"}


@pytest.mark.parametrize("step", [0.5, 0.9])
def test_coarse_records_are_described_and_drawn(step, tmp_path):
    path = sine_file(tmp_path / "coarse.csv", step, samples=60)
    options = ["--units", "g", "--highpass", "0.01", "--output", str(tmp_path / "out")]
    assert main(["motion", str(path), *options]) == 0
    assert (tmp_path / "out" / "coarse.csv.png").is_file()


@pytest.mark.parametrize(
    "arguments",
    [["--mass-ratio", "1e9"], ["--stroke", "-1"], ["--velocity", "nan"], ["--amplitude", "-1"]],
)
def test_values_out_of_range_are_one_line(arguments, capsys, tmp_path):
    path = sine_file(tmp_path / "mine.csv")
    assert main(["motion", str(path), "--units", "g", *arguments]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.parametrize(
    "which", [["--num-noise-motions", "0"], ["--no-records", "--num-noise-motions", "1"]]
)
def test_no_controller_is_judged_without_a_motion(which, capsys):
    assert main(["compare", "--amplitude", "0", "--controllers", "none", *which]) == 2
    assert "amplitude = 0.0: " in capsys.readouterr().err


def test_a_record_of_zeros_holds_no_motion(capsys, tmp_path):
    path = tmp_path / "zeros.csv"
    path.write_text("".join(f"{0.01 * i:.2f} 0.0\n" for i in range(200)))
    compared = ["compare", "--motion", str(path), "--motion.units", "g", "--num-noise-motions", "0"]
    for command in (["motion", str(path), "--units", "g"], compared):
        assert main(command) == 2
        assert "all zeros" in capsys.readouterr().err


def test_a_reader_that_goes_ends_the_command_quietly(tmp_path):
    path = sine_file(tmp_path / "mine.csv")
    command = [sys.executable, "-m", "agents", "motion", str(path), "--units", "g"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, cwd=tmp_path) as process:
        process.stdout.close()  # before anything is written
        err, code = process.stderr.read(), process.wait()
    # A slow machine is told that the command works.
    working = all(line.startswith(b"shake motion: ") for line in err.splitlines())
    assert working and code == 141


@pytest.mark.parametrize(
    ("content", "message"),
    [("", "empty"), ("hello\n", "known formats"), (None, "can be read"), ("1 2\n2 3\n3 4", "cut off")],
)
def test_a_bad_file_is_one_line_on_standard_error_and_exit_code_2(content, message, tmp_path, capsys):
    path = tmp_path / "bad.csv"
    if content is not None:
        path.write_text(content.replace("3 4", "30 40") if message == "cut off" else content)
    assert main(["motion", str(path), "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == "" and len(err.splitlines()) == 1
    assert err.startswith("shake: ") and "bad.csv" in err and message in err


def compare(capsys, tmp_path, *arguments):
    common = [
        "compare",
        "--no-records",
        "--controllers",
        "lqr",
        "none",
        "--force",
        "--output",
        tmp_path / "out",
    ]
    return run_json(capsys, *common, *arguments)[0]


def test_compare_runs_every_channel_scaled_to_the_table(capsys, tmp_path):
    found = compare(capsys, tmp_path, "--num-noise-motions", "1", "--duration", "2", "--motion", CICLC)
    by_group = {(row["controller"], row["group"]): row for row in found["summaries"]}
    assert set(by_group) == {(c, g) for c in ("lqr", "none") for g in ("motions", "filtered noise")}
    assert by_group["lqr", "motions"]["earthquakes"] == 3
    assert (
        by_group["lqr", "motions"]["relative_cost"] == 1.0 < by_group["none", "motions"]["relative_cost"]
    )
    names = [row["earthquake"] for row in found["episodes"]["lqr"]]
    assert names[:3] == [record.name for record in read_motion(CICLC)]
    assert found["traced"] == names[0]
    plain = compare(capsys, tmp_path, "--num-noise-motions", "0", "--no-scale", "--motion", CICLC)
    for scaled, whole, record in zip(
        found["episodes"]["none"], plain["episodes"]["none"], read_motion(CICLC), strict=False
    ):
        motion = RecordedMotion(record=record, highpass_frequency=0.2, lowpass_frequency=25.0)
        # Without control the cost is that of the target alone: quadratic in its amplitude.
        assert scaled["cost"] / whole["cost"] == pytest.approx(
            fit_amplitude(motion).factor ** 2, rel=1e-6
        )


def test_compare_prints_the_scale_and_takes_several_files(capsys, tmp_path):
    other = tmp_path / "napa.csv"
    name = "napa2014_68150_hne"
    from shake_env.records import write_record

    write_record(load_record(name), other)
    arguments = ["compare", "--no-records", "--num-noise-motions", "0", "--controllers", "lqr"]
    arguments += ["--motion", str(CICLC), "--motion", str(other), "--output", str(tmp_path / "out")]
    assert main(arguments) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "motions, 4 earthquakes" in out
    assert "motion napa: amplitude x 0.5269 (for its 133 mm of displacement)" in out
    assert main([*arguments, "--no-scale", "--force"]) == 0
    assert "amplitude x 1 (as recorded; the table needs 0.5269)" in " ".join(
        capsys.readouterr().out.split()
    )


def test_the_outline_of_a_long_curve_keeps_its_ends_and_peaks():
    rng = np.random.default_rng(0)
    values = rng.standard_normal(50_123)
    time = 0.01 * np.arange(len(values))
    drawn_time, drawn = _outline(time, values)
    assert len(drawn) == len(drawn_time) == 2 * COLUMNS
    assert drawn.min() == values.min() and drawn.max() == values.max()
    assert drawn_time[0] == 0.0 and drawn_time[-1] > time[-1] - 1.0
    assert _outline(time[:50], values[:50])[1] is not drawn


def test_help_teaches_by_example(capsys):
    with pytest.raises(SystemExit) as exit_info:
        main(["motion", "--help"])
    assert exit_info.value.code == 0
    assert "shake motion CICLC.v1" in capsys.readouterr().out
