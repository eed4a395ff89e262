"""The Python in README and docs runs as it stands, and their links lead somewhere."""

import re
import shutil
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
RECORD = ROOT / "tests" / "data" / "CICLC_trimmed.v1"
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page):
    return re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)


def test_the_ten_lines_run(capsys):
    (code,) = blocks(ROOT / "README.md")
    exec(compile(code, "README.md", "exec"), {})
    out = capsys.readouterr().out
    cost = float(re.search(r"mean stage cost ([\d.]+)", out)[1])
    assert 0.1 < cost < 0.3


@pytest.mark.parametrize("page", [page for page in PAGES[1:] if blocks(page)], ids=lambda p: p.name)
def test_the_python_in_docs_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(RECORD, tmp_path / "CICLC.v1")  # the pages read a file of this name
    names = {}  # a page goes on where its last block stopped
    for code in blocks(page):
        exec(compile(code, page.name, "exec"), names)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_every_linked_file_exists(page):
    links = re.findall(r"\]\((?!https?://)([^)#]+)\)", page.read_text(encoding="utf-8"))
    for link in links:
        assert (page.parent / link).exists(), link
    assert page.name != "README.md" or len(links) >= 5
