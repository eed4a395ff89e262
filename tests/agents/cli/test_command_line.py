"""The command line itself: what starts it, its help, how it reports progress."""

import io
import json
import os
import re
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from rich.console import Console

from agents import progress
from agents.__main__ import main
from agents.cli.commands import COMMANDS, parse, scenario_options
from agents.progress import Display, progress_bar

ROOT = Path(__file__).parents[3]
HEAVY = (
    "torch", "stable_baselines3", "matplotlib", "pandas", "numba", "scipy.linalg", "scipy.signal",
    "scipy.stats", "scipy.optimize", "control",
)  # fmt: skip


def shake(*words, **options):
    """Run the command line in a process of its own."""
    command = [sys.executable, "-m", "agents", *words]
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, **options)


# Start and help


def test_no_help_imports_anything_heavy():
    """In one process, for every command: what none imports, each imports not."""
    script = (
        "import sys\n"
        "from agents.__main__ import main\n"
        "from agents.cli.commands import COMMANDS\n"
        "main(['--help']); main(['--version'])\n"
        "for name in COMMANDS:\n"
        "    try: main([name, '--help'])\n"
        "    except SystemExit as end: assert not end.code, name\n"
        f"print('HEAVY', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert out.stdout.splitlines()[-1] == "HEAVY []", out.stderr


@pytest.mark.slow  # a measurement of time, on a machine with nothing else to do
@pytest.mark.parametrize("words", [["--help"], *([name, "--help"] for name in COMMANDS)])
def test_help_takes_less_than_a_second_of_processor_time(words):
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert shake(*words).returncode == 0
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 1.0


def test_help_names_every_command_and_fits_80_columns(capsys):
    assert main(["--help"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    for name in COMMANDS:
        assert any(line.startswith(f"  {name} ") for line in lines), name
    assert main([]) == 2


def test_the_scenario_options_stand_behind_one_heading(capsys):
    with pytest.raises(SystemExit):
        main(["compare", "--help"])
    brief = capsys.readouterr().out
    with pytest.raises(SystemExit):
        main(["compare", "--help-scenario"])
    whole = capsys.readouterr().out
    for option in ("--stories", "--highpass-frequency", "--sensing", "--delay"):
        line = re.compile(rf"^\W*{option}\b", re.MULTILINE)
        assert line.search(whole) and not line.search(brief)
    assert "--help-scenario" in brief and "--scenario" in brief
    number = int(re.search(r"(\d+) more options", " ".join(re.sub("[│\n]", " ", brief).split()))[1])
    listed = set(re.findall(r"^\W*(--[a-z][\w-]+)", whole, re.MULTILINE)) - {"--scenario"}
    assert number == len(listed)
    assert parse(["compare", "--stories", "5"]).scenario.stories == 5
    assert main(["list", "--help-scenario"]) == 2


def default_scenario(text):
    """The default of --scenario that a help text states; None without that option."""
    line = " ".join(re.sub("[│\n]", " ", text).split())
    found = re.search(
        r"--(?:config\.scenario\.)?scenario (?:STR|\{None\}\|STR) .*?\(default: (.*?)\)", line
    )
    return found and found[1]


@pytest.mark.parametrize("name", COMMANDS)
def test_help_states_the_scenario_that_a_command_has(name, capsys):
    kind = COMMANDS[name].load()
    own = scenario_options(kind)
    with pytest.raises(SystemExit):
        main([name, "--help"])
    brief = capsys.readouterr().out
    if own is None:  # a name or a file alone, which nothing changes
        assert "more options change it" not in brief
        assert main([name, "--help-scenario"]) == 2
        return
    assert default_scenario(brief) == own[1].scenario
    with pytest.raises(SystemExit):
        main([name, "--help-scenario"])
    assert default_scenario(capsys.readouterr().out) == own[1].scenario


def test_what_runs_is_what_help_states():
    assert parse(["rehearse"]).scenario.build().name == "laboratory"
    assert parse(["plan", "a_record"]).scenario.build().name == "laboratory"
    assert parse(["play"]).scenario.build().name == "linear"


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["list"], ["compare", "--help"]])
def test_a_reader_that_leaves_gets_no_traceback(words):
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-m", "agents", *words], stdout=pipe, stderr=pipe) as process:
        process.stdout.close()
        err = process.stderr.read()
    assert b"Traceback" not in err and b"Exception" not in err


@pytest.mark.parametrize(
    "words", [["compare", "--tuned"], ["tune", "pid", "--output"], ["tune", "pid", "--storage"]]
)
def test_pipes_and_devices_are_refused_at_the_door(words, tmp_path, capsys):
    os.mkfifo(tmp_path / "pipe")
    for file in (tmp_path / "pipe", "/dev/zero"):
        assert main([*words, str(file)]) == 2
        assert "is a pipe or a device" in capsys.readouterr().err


def test_version(capsys):
    from importlib.metadata import version

    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"shake-env {version('shake-env')}\n"


def test_list_has_a_line_for_every_name(capsys):
    from baselines.registry import CLASSICAL
    from shake_env import RECORD_NAMES, SCENARIO_NAMES

    assert main(["list", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert tuple(found["scenarios"]) == SCENARIO_NAMES
    assert tuple(found["records"]) == RECORD_NAMES
    assert list(found["controllers"]) == [*CLASSICAL, "oracle"]
    assert set(found["policies"]) == {"ppo", "apg", "dagger", "dagger-apg", "dagger-apg-long", "sac"}
    assert all(len(text) > 10 for kind in found.values() for text in kind.values())
    assert main(["list", "scenarios"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines if line] == ["scenarios", *SCENARIO_NAMES]


def test_a_mistaken_command_gets_the_nearest_one(capsys):
    assert main(["comprae"]) == 2
    assert "did you mean 'compare'" in capsys.readouterr().err
    assert main(["--foo"]) == 2


def test_completion_knows_commands_and_options():
    done = shake("--tyro-print-completion", "bash")
    assert done.returncode == 0
    assert "tune-training" in done.stdout and "--control-rate" in done.stdout


# Quiet and verbose


def test_quiet_prints_nothing_and_verbose_where_an_error_was_raised(tmp_path, capsys):
    record, folder = str(ROOT / "tests" / "data" / "CICLC_trimmed.v1"), tmp_path / "a"
    assert main(["motion", record, "--output", str(folder), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert any(folder.iterdir())
    assert main(["--quiet", "design", "--json"]) == 0  # may stand ahead of the command, too
    out, err = capsys.readouterr()
    assert json.loads(out)["analytic_cost"] > 0.0 and err == ""
    assert main(["design", "--mass-ratio", "-1"]) == 2
    plain = capsys.readouterr().err
    assert main(["design", "--mass-ratio", "-1", "--verbose"]) == 2
    whole = capsys.readouterr().err
    assert "Traceback" not in plain and "Traceback" in whole
    assert whole.splitlines()[-1] == plain.splitlines()[-1]
    assert main(["design", "--quiet", "--verbose"]) == 2


def test_a_closed_pipe_is_no_error():
    shell = f"{sys.executable} -m agents scenario --scenario records | head -n 1"
    done = subprocess.run(shell, shell=True, capture_output=True, text=True, cwd=ROOT)
    assert "Traceback" not in done.stderr and "BrokenPipe" not in done.stderr
    assert done.stdout.count("\n") == 1


# Progress


def test_a_log_is_told_within_two_seconds_that_a_command_works(monkeypatch, capfd):
    monkeypatch.undo()  # the tests' own patience
    assert progress.FIRST_LINE < 2.0
    display = Display()
    display.begin("shake compare")
    began = time.monotonic()
    while time.monotonic() - began < 2.0 and not (told := capfd.readouterr().err):
        time.sleep(0.05)
    display.end()
    assert told == "shake compare: working\n"
    assert not any(thread.name == "shake-progress" for thread in threading.enumerate())


def test_a_quick_command_leaves_no_line(capfd):
    display = Display()
    display.begin("shake design")
    display.end()
    assert capfd.readouterr().err == ""


def test_progress_in_a_log_is_lines_and_on_a_terminal_bars(monkeypatch, capfd):
    progress.display.begin("shake tune")
    with progress_bar() as bars:
        task = bars.add_task("tuning pid", total=4)
        bars.update(task, completed=1)
        bars.update(task, completed=2)  # too soon for another line
    progress.display.end()
    assert capfd.readouterr().err == "tuning pid 25 %\n"
    stream = io.StringIO()
    progress.display.begin("shake tune")
    monkeypatch.setattr(progress.display, "console", Console(file=stream, force_terminal=True, width=60))
    with progress_bar() as bars:
        assert [task.description for task in bars.tasks] == ["preparing"]
        task = bars.add_task("tuning pid", total=4)
        bars.update(task, completed=4)
        assert [task.description for task in bars.tasks] == ["tuning pid"]
    progress.display.end()
    assert "tuning pid" in stream.getvalue() and "100 %" in stream.getvalue()


def test_a_terminal_shows_at_once_that_a_command_works(monkeypatch):
    stream = io.StringIO()
    terminal = Console(file=stream, force_terminal=True, width=60)
    monkeypatch.setattr(progress, "Console", lambda **options: terminal)
    display = Display()
    display.begin("shake compare")
    shown = stream.getvalue()
    with display.suspended():
        pass
    display.end()
    assert "shake compare: working" in shown


@pytest.mark.slow  # compiles the simulation, a minute
def test_the_first_compilation_says_that_it_happens_once(tmp_path):
    began = time.monotonic()
    words = [sys.executable, "-m", "agents", "compare", "--no-records", "--num-noise-motions", "2",
             "--duration", "1", "--controllers", "lqr", "--json"]  # fmt: skip
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    with subprocess.Popen(
        words, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    ) as process:
        lines = [(time.monotonic() - began, line) for line in process.stderr]
    assert process.returncode == 0
    (when,) = [when for when, line in lines if "compiling" in line]
    assert when < 10.0 < lines[-1][0]
    again = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert "compiling" not in again.stderr


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device here")
@pytest.mark.parametrize("words", [["--help"], ["show-scenario", "--json"]])
def test_a_full_standard_output_is_named_without_a_traceback(words):
    command = [sys.executable, "-m", "agents", *words]
    with open("/dev/full", "w") as full:
        out = subprocess.run(command, cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert out.returncode == 2
    assert re.fullmatch(r"shake: standard output.*: No space left on device\n", out.stderr), out.stderr
