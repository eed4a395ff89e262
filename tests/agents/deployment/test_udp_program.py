"""The exported UDP program, started by hand as the guide says."""

import re
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from agents.deployment.compiled import run_compiler
from agents.deployment.export import export_c
from shake_env import make_scenario

GUIDE = Path(__file__).parents[3] / "docs" / "howto" / "deploy.md"
SILENCE = "#define PATIENCE 60 "
pytestmark = pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))) or not shutil.which("make"),
    reason="no C compiler or no make is installed",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("udp")
    export_c("lqg", make_scenario("laboratory"), where)
    subprocess.run(["make", "-C", str(where), "udp"], check=True, capture_output=True)
    return where


@contextmanager
def started(program):
    """Give the process, and the port that it prints first."""
    with subprocess.Popen([str(program)], stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process, int(process.stdout.readline())
        finally:
            process.kill()


def test_the_guides_table_talks_to_it(folder, capsys):
    with started(folder / "lqg_laboratory_udp") as (process, port):
        text = GUIDE.read_text(encoding="utf-8")
        (code,) = [
            code
            for code in re.findall(r"```python\n(.*?)```", text, re.DOTALL)
            if "one_test(port" in code
        ]
        names = {}
        exec(compile(code, GUIDE.name, "exec"), names)
        names["one_test"](port, periods=4)
        printed = capsys.readouterr().out.splitlines()
        assert [int(line.split()[0]) for line in printed] == [0, 1, 2, 3]
        assert process.wait(timeout=20) == 0  # the flag of the end


@pytest.mark.skipif(sys.platform != "linux", reason="/proc/net/udp tells where a program listens")
def test_it_listens_on_the_loopback_only(folder):
    with started(folder / "lqg_laboratory_udp") as (_, port):
        rows = [line.split()[1] for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
        own = [
            address for address, number in (row.split(":") for row in rows) if int(number, 16) == port
        ]
        assert own == [f"{int.from_bytes(bytes([127, 0, 0, 1]), sys.byteorder):08X}"]


def test_it_ends_after_the_silence_that_the_guide_states(folder, tmp_path):
    source = (folder / "lqg_laboratory_udp.c").read_text(encoding="utf-8")
    assert SILENCE in source and "after 60 s without a datagram" in GUIDE.read_text(encoding="utf-8")
    short = tmp_path / "short.c"
    short.write_text(source.replace(SILENCE, "#define PATIENCE 1 "), encoding="utf-8")
    program = tmp_path / "short"
    run_compiler(["-std=c99", f"-I{folder}", "-o", program, folder / "lqg_laboratory.c", short, "-lm"])
    began = time.monotonic()
    with started(program) as (process, _):
        assert process.wait(timeout=20) == 0
        assert time.monotonic() - began >= 0.9
