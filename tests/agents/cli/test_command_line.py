"""The command line itself: what starts it, its help, its tables, where it writes, scenario files."""

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
from agents.cli.commands import COMMANDS, parse
from agents.cli.output_path import output_file, output_folder
from agents.progress import Display, progress_bar
from agents.reporting.comparison_tables import COLUMNS
from agents.reporting.terminal import OutputConsole, print_markdown, print_table
from shake_env import command_line, make_scenario
from shake_env.errors import ParameterError, ScenarioError
from shake_env.scenario.scenario_file import scenario_fields, scenario_of

ROOT = Path(__file__).parents[3]
HEAVY = ("torch", "stable_baselines3", "matplotlib", "pandas", "numba", "scipy.signal", "scipy.stats",
         "scipy.optimize", "control")  # fmt: skip


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
    assert set(found["policies"]) == {"ppo", "apg", "dagger", "sac"}
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


# Tables


HEADINGS = (
    "controller",
    *(heading.format(reference="LQG", drive="current\nmA") for heading, _ in COLUMNS),
)
NAMES = ("lqr", "lqg-dac", "a-run-with-a-long-name-of-its-own")
ROWS = [[name, "1.234 [1.111, 1.333]", *(["12.3"] * (len(HEADINGS) - 2))] for name in NAMES]


def printed(width, terminal=True, **options):
    stream = io.StringIO()
    console = OutputConsole(file=stream, force_terminal=terminal, width=width, color_system=None)
    print_table(console, HEADINGS, ROWS, **options)
    return re.sub(r"\x1b\[[\d;?]*[a-zA-Z]", "", stream.getvalue())


@pytest.mark.parametrize("width", [50, 80, 100, 200])
def test_names_are_whole_at_every_width_and_no_figure_is_lost(width):
    text = printed(width, title="records, 6 earthquakes")
    lines = text.splitlines()
    assert max(len(line.rstrip()) for line in lines) <= max(width, 55)  # of one name and its cost
    blocks = sum(line.startswith(f"{NAMES[0]} ") for line in lines)
    for name in NAMES:
        rows = [line for line in lines if line.split()[:1] == [name]]
        assert len(rows) == blocks
        assert sum(row.count("12.3") for row in rows) == len(HEADINGS) - 2
    assert (blocks == 1) == (width == 200)
    for word in " ".join(HEADINGS).split():
        assert word in text


def test_a_pipe_gets_one_unwrapped_line_a_row():
    lines = printed(80, terminal=False).splitlines()
    assert len(lines) == 1 + len(ROWS)
    assert [line.split()[0] for line in lines] == ["controller", *NAMES]
    assert [re.split(r"  +", line.strip()) for line in lines[1:]] == ROWS
    stream = io.StringIO()
    OutputConsole(file=stream, force_terminal=False, width=80).print("word " * 60)
    assert stream.getvalue().count("\n") == 1


def test_markdown_is_a_table_on_a_terminal_and_itself_in_a_pipe():
    text = "| controller | cost |\n|---|---|\n| lqg-dac | 1.0 |\n\nOne sentence.\n"
    for terminal in (False, True):
        stream = io.StringIO()
        console = OutputConsole(file=stream, force_terminal=terminal, width=40, color_system=None)
        print_markdown(console, text)
        shown = stream.getvalue()
        assert "lqg-dac" in shown and "One sentence." in shown
        assert ("|---|" in shown) != terminal


# Where results go


def test_the_usual_folder_is_numbered_and_a_given_one_never_overwritten(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    usual = Path("out/compare")
    assert output_folder(None, usual) == usual
    assert output_folder(None, usual) == usual  # nothing was written to it
    (usual / "comparison.json").write_text("{}")
    assert output_folder(None, usual) == Path("out/compare-2")
    (Path("out/compare-2") / "x").write_text("")
    assert output_folder(None, usual) == Path("out/compare-3")
    with pytest.raises(ParameterError, match="--force"):
        output_folder(usual, usual)
    assert output_folder(usual, usual, force=True) == usual
    file = Path("out/evaluate/linear.json")
    assert output_file(None, file) == file
    file.write_text("{}")
    assert output_file(None, file) == Path("out/evaluate/linear-2.json")
    assert output_file(file, Path("x.json")) == file


@pytest.mark.parametrize(
    "words",
    [
        "compare --output {}", "compare --report {}", "evaluate lqr --output {}/x.json",
        "robustness --output {}", "components --output {}", "validate --output {}",
        "reproduce --output {}", "export analytic {}/x.onnx", "watch --save {}/x.gif",
        "tune pid --scenario laboratory --output {}/x.json", "benchmark --results {}",
        "tune-training linear/ppo --storage {}/x.db",
        "motion mine.csv --output {}", "accept mine.csv --output {}", "accept --make {}/x.csv",
        "calibrate --output {}/x.json", "sequence rehearse --output {}/x.json",
        "gradient-noise --output {}/x.json",
    ],
)  # fmt: skip
def test_unwritable_output_is_found_before_the_work_begins(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "shake_env.simulation.simulation.Simulation.__init__", None
    )  # any use of it fails
    (tmp_path / "file").write_text("no folder")
    assert main(words.format(tmp_path / "file" / "below").split()) == 2
    err = capsys.readouterr().err.splitlines()[-1]
    assert "cannot be written (Not a directory)" in err and "below" in err


# Scenario files


def test_a_scenario_file_gives_the_scenario_again(tmp_path, capsys):
    changes = ["--set", "sensing.preview=0.2", "--set", "uncertainty.mass_ratio=[0.1,0.5]",
               "--stories", "3", "--set", "name=mine"]  # fmt: skip
    assert main(["show-scenario", "--scenario", "laboratory", *changes, "--json"]) == 0
    file = tmp_path / "mine.json"
    file.write_text(capsys.readouterr().out)
    built = parse(["show-scenario", "--scenario", "laboratory", *changes]).scenario.build()
    assert built.name == "mine" and built.specimen.stories == 3
    assert make_scenario(file) == make_scenario(str(file)) == built
    assert parse(["design", "--scenario", str(file)]).scenario.build() == built
    changed = make_scenario(file, {"delay": 1})
    assert changed.delay == 1 and changed != built
    again = parse(["evaluate", "lqg", "--scenario", str(file), "--json"]).scenario
    assert again.build() == built
    kept = again.without_file()
    file.unlink()
    assert kept.build() == built and kept.scenario == "mine"
    import gymnasium

    with pytest.raises(ScenarioError, match="there is no such file"):
        gymnasium.make("shake_env:ShakeTable-v0", scenario=str(file))


def test_a_trained_policy_does_not_depend_on_a_scenario_file(tmp_path):
    from agents.training.config import TrainConfig, config_of

    file = tmp_path / "mine.json"
    fields = scenario_fields(make_scenario("yielding"))
    file.write_text(json.dumps({"name": "yielding", "fields": fields}))
    config = parse(["train", "--run-dir", "x", "--config.scenario.scenario", str(file)]).config
    kept = TrainConfig(scenario=config.scenario.without_file())
    file.unlink()
    again = config_of(json.loads(json.dumps(kept.to_json())))
    assert again == kept and again.scenario.build() == make_scenario("yielding")


@pytest.mark.parametrize(
    "name", ["linear", "as-printed", "laboratory", "unknown-specimen", "yielding", "records"]
)
def test_every_named_scenario_survives_its_file(name):
    scenario = make_scenario(name)
    again = scenario_of(json.loads(json.dumps(scenario_fields(scenario), allow_nan=False)))
    assert again == scenario and hash(again) == hash(scenario)


FIELDS = scenario_fields(make_scenario("laboratory"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"specimen.masses": None}, r"specimen.masses = None: must be a list of numbers \[kg\]"),
        ({"specimen.masses": [1.0, "2"]}, r"specimen.masses\[1\] = '2': must be a number \[kg\]"),
        ({"control_rate": "200"}, r"control_rate = '200': must be a number \[Hz\]"),
        ({"control_rate": True}, r"control_rate = True: must be a number \[Hz\]"),
        ({"control_rate": 333.0}, "control_rate = 333.0: its period"),
        ({"sensing.history": 1.5}, "sensing.history = 1.5: must be a whole number"),
        ({"limits.curent": 1.0}, "limits.curent'?: did you mean 'limits.current'|did you mean"),
        ({"control_rate.x": 1.0}, "a part of it has a value already"),
        ({"sensing.sensors.load_pressure.signal": "base_shear"}, "must be 'load_pressure'"),
        ({"motion..duration": 1.0}, "must be names with dots"),
        ({"motion.motions[0].record": "x"}, "motion"),
    ],
)
def test_a_wrong_field_of_a_scenario_file_is_named(change, message, tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(json.dumps({"fields": {**FIELDS, **change}}))
    with pytest.raises((ScenarioError, ParameterError), match=message):
        make_scenario(file)


@pytest.mark.parametrize("left_out", ["delay", "motion.duration", "sensing.sensors.load_pressure.noise"])
def test_a_missing_field_of_a_scenario_file_is_named(left_out):
    with pytest.raises(ScenarioError, match=re.escape(f"{left_out} = None: is missing")):
        scenario_of({path: value for path, value in FIELDS.items() if path != left_out})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is no JSON"),
        ("[1]", "must hold one JSON object"),
        ('{"name": "x"}', "has no object 'fields'"),
        ('{"fields": {}, "feilds": {}}', "did you mean 'fields'"),
        ('{"fields": {"delay": 1, "delay": 2}}', "stands twice"),
        ('{"fields": {"delay": NaN}}', "no JSON number"),
        ("[" * 100_000, "is no JSON"),
        ('{"fields": {"name": "\\ud800"}}', "is missing"),
    ],
)
def test_a_text_that_is_no_scenario(text, message, tmp_path):
    file = tmp_path / "mine.json"
    file.write_text(text)
    with pytest.raises(ScenarioError, match=message):
        make_scenario(file)


def test_what_is_no_file_of_text_is_refused(tmp_path):
    for path, why in (
        (tmp_path, "is a folder"),
        (tmp_path / "absent.json", "no such file"),
        (Path("/dev/zero"), "is a pipe or a device"),
    ):
        with pytest.raises(ScenarioError, match=why):
            make_scenario(path)
    (tmp_path / "x.json").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ScenarioError, match="is no JSON"):
        make_scenario(tmp_path / "x.json")


# The entry point


def test_the_entry_point_knows_its_own_packages():
    assert command_line.foreign_package() is None and command_line.missing_package() is None


def test_another_distributions_package_is_recognised(tmp_path):
    """As openai-agents has one: first on the path, or over this project's in one folder."""
    (tmp_path / "agents").mkdir()
    (tmp_path / "agents" / "__init__.py").write_text("VERSION = 1\n")
    script = "from shake_env.command_line import main; raise SystemExit(main(['--version']))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, env=environment, cwd=tmp_path
    )
    assert done.returncode == 2 and done.stdout == ""
    assert "'agents'" in done.stderr and "environment of its own" in done.stderr
    assert str(tmp_path) in done.stderr


def test_a_missing_package_of_the_command_line_is_named(monkeypatch, capsys):
    monkeypatch.setattr(command_line, "PACKAGES", ("no_such_package",))
    assert command_line.main(["list"]) == 2
    assert command_line.main(["--version"]) == 0
    err = capsys.readouterr().err
    assert "no_such_package" in err and "pip install '.[agents]'" in err


ROOMS = {"agents": "cli", "baselines": "lqr"}


def test_a_wheel_holds_no_file_that_others_hold():
    """What setup.py leaves out, by its own class; the build of a wheel is a slow test."""
    import runpy
    from unittest import mock

    with mock.patch("setuptools.setup"):
        built = runpy.run_path(str(ROOT / "setup.py"))["BuildWithoutSharedFiles"]
    from setuptools.dist import Distribution

    options = {"script_name": "setup.py", "package_dir": {"": str(ROOT)}}
    step = built(Distribution(options))
    step.finalize_options()
    for package in ("agents", "baselines"):
        modules = {each[1] for each in step.find_package_modules(package, str(ROOT / package))}
        assert "__init__" not in modules and len(modules) > 2
        rooms = step.find_package_modules(
            f"{package}.{ROOMS[package]}", str(ROOT / package / ROOMS[package])
        )
        assert "__init__" in {each[1] for each in rooms}
        assert (ROOT / package / "__init__.py").read_bytes() == b""
    assert "__init__" in {e[1] for e in step.find_package_modules("shake_env", str(ROOT / "shake_env"))}


def test_every_install_hint_is_a_source_install():
    """No page and no message may name a package index that lacks this package."""
    texts = [ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
    texts += [
        path for each in ("agents", "baselines", "shake_env") for path in ROOT.glob(f"{each}/**/*.py")
    ]
    for path in texts:
        assert not re.search(r"pip install ['\"]?shake[-_]env", path.read_text(encoding="utf-8")), path
