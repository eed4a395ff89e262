"""The Python in README and docs runs as it stands, and their links lead somewhere."""

import re
import shutil
from pathlib import Path

import gymnasium
import pytest

from agents.policies.registry import controllers
from shake_env.scenario.presets import NAMED

ROOT = Path(__file__).parents[1]
RECORD = ROOT / "tests" / "data" / "CICLC_trimmed.v1"
README = ROOT / "README.md"
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]


# Before a block that takes long: kept out of the default suite, and run by -m slow.
LONG = "<!-- long: runs with pytest -m slow -->\n"


def blocks(page, slow=False):
    found = re.findall(
        rf"({re.escape(LONG)})?```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL
    )
    return [code for long, code in found if slow or not long]


def test_the_readmes_python_runs(capsys):
    control, training = blocks(README)
    exec(compile(control, "README.md", "exec"), {})
    cost = float(re.search(r"mean stage cost ([\d.]+)", capsys.readouterr().out)[1])
    assert 0.1 < cost < 0.3
    exec(compile(training, "README.md", "exec"), {})
    ratio = float(re.search(r"ratio ([\d.]+)", capsys.readouterr().out)[1])
    assert ratio > 1.0  # LQR is optimal, and this training is short


@pytest.mark.parametrize("page", [page for page in PAGES[1:] if blocks(page)], ids=lambda p: p.name)
def test_the_python_in_docs_runs(page, tmp_path, monkeypatch):
    if "baselines.planning" in "".join(blocks(page)):
        pytest.importorskip("numba")
    monkeypatch.chdir(tmp_path)
    shutil.copy(RECORD, tmp_path / "CICLC.v1")  # the pages read a file of this name
    run(page)


def run(page, slow=False):
    names = {}  # a page goes on where its last block stopped
    for code in blocks(page, slow):
        exec(compile(code, page.name, "exec"), names)


def test_a_long_block_waits_for_the_slow_suite(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(f"```python\nx = 1\n```\n\n{LONG}```python\nassert x == 2\n```\n", encoding="utf-8")
    run(page)
    with pytest.raises(AssertionError):
        run(page, slow=True)


@pytest.mark.slow
def test_pages_with_long_blocks_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(RECORD, tmp_path / "CICLC.v1")
    for page in PAGES:
        if blocks(page) != blocks(page, slow=True):
            run(page, slow=True)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_linked_file_exists(page):
    links = re.findall(r"\]\((?!https?://)([^)#]+)\)", page.read_text(encoding="utf-8"))
    for link in links:
        assert (page.parent / link).exists(), link
    assert page.name != "README.md" or len(links) >= 5


def test_the_readmes_table_of_environments_is_true():
    rows = re.findall(
        r"^\| `(ShakeTable-[\w-]+)` \| ([^|]*) \|", README.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert {name for name, _ in rows} == {f"ShakeTable-{each}-v0" for each in (*NAMED, "sequence")}
    for name, observation in rows:
        size = int(re.findall(r"\d+", observation)[-1])
        env = gymnasium.make(f"shake_env:{name}")
        assert env.observation_space.shape == (size,), name
        env.close()


def test_the_readme_names_every_controller():
    text = README.read_text(encoding="utf-8")
    assert [name for name in controllers() if f"`{name}`" not in text] == []
