"""The entry point of the command line: its own packages, what is missing, what a wheel holds."""

import os
import re
import subprocess
import sys
from pathlib import Path

from shake_env import command_line

ROOT = Path(__file__).parents[2]


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
