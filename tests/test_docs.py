"""The site builds strictly, without a network; generated pages are current; commands are understood."""

import ast
import json
import re
import runpy
import shlex
import shutil
import socket
from pathlib import Path

import pytest

from agents.__main__ import main
from agents.cli.commands import COMMANDS, parse
from shake_env import make_scenario
from shake_env.scenario.scenario_file import parse_toml, scenario_fields
from shake_env.scenario.scenario_writer import write_scenario

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
PACKAGES = ("shake_env", "baselines", "agents")
RECORD = ROOT / "tests" / "data" / "CICLC_trimmed.v1"


@pytest.fixture(scope="module")
def generator():
    return runpy.run_path(str(DOCS / "generate.py"))


# The site


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; a look-up of any host fails, and the strict build with it."""
    from mkdocs.commands.build import build
    from mkdocs.config import load_config

    folder = tmp_path_factory.mktemp("site")
    patch = pytest.MonkeyPatch()

    def no_network(*arguments, **options):
        raise OSError("the site must build without a network")

    patch.setattr(socket, "getaddrinfo", no_network)
    patch.setattr(socket.socket, "connect", no_network)
    patch.setenv("NO_MKDOCS_2_WARNING", "1")
    with pytest.warns() as caught:  # templates and Markdown extensions warn of their own future
        import warnings

        warnings.warn("so that there is one", UserWarning, stacklevel=1)
        config = load_config(str(ROOT / "mkdocs.yml"), site_dir=str(folder), strict=True)
        build(config)
    patch.undo()
    assert all(w.category is not ResourceWarning for w in caught)
    return folder


def test_the_site_has_every_page(site):
    for page in DOCS.rglob("*.md"):
        name = page.relative_to(DOCS).with_suffix("")
        folder = name.parent if name.name in ("index", "README") else name
        assert (site / folder / "index.html").is_file(), name


LOADED_FROM_A_HOST = re.compile(
    r"""<(?:script|img|iframe|source)\b[^>]*\bsrc=["']?(?:https?:)?//|"""
    r"""<link\b[^>]*rel=["']?(?:stylesheet|preconnect|preload)["']?[^>]*href=["']?(?:https?:)?//|"""
    r"""<link\b[^>]*href=["']?(?:https?:)?//[^>]*rel=["']?(?:stylesheet|preconnect|preload)"""
)


def test_nothing_comes_from_another_host(site):
    """Links may lead away; what a browser loads by itself may not."""
    for page in site.rglob("*.html"):
        assert not LOADED_FROM_A_HOST.search(page.read_text(encoding="utf-8")), page
    for style in site.rglob("*.css"):
        assert not re.search(r"url\(['\"]?(?:https?:)?//", style.read_text(encoding="utf-8")), style


@pytest.mark.parametrize(
    ("tag", "loads"),
    [
        ('<link rel="stylesheet" href="https://fonts.example/x.css">', True),
        ('<link href="//fonts.example/x.css" rel=preload>', True),
        ('<script src="https://cdn.example/x.js"></script>', True),
        ('<img alt="a" src=//images.example/x.png>', True),
        ('<a href="https://example.org/">a link</a>', False),
        ('<link rel="canonical" href="https://example.org/page/">', False),
        ('<img src="../figures/x.png">', False),
    ],
)
def test_the_rule_about_hosts_tells_loading_from_links(tag, loads):
    assert bool(LOADED_FROM_A_HOST.search(tag)) == loads


@pytest.mark.parametrize("package", PACKAGES)
def test_every_room_is_a_topic_of_the_api_pages(generator, package):
    rooms = {p.name for p in (ROOT / package).iterdir() if any(p.glob("*.py"))}
    assert set(generator["api"].__globals__["TOPICS"][package]) == rooms


@pytest.mark.parametrize("package", PACKAGES)
def test_the_api_pages_hold_every_public_name(site, package):
    html = (site / "api" / package / "index.html").read_text(encoding="utf-8")
    anchors = set(re.findall(r'id="([\w.]+)"', html))
    for module in modules(package):
        assert module in anchors, module
        missing = [name for name in own_names(module) if f"{module}.{name}" not in anchors]
        assert not missing, module


# Docstrings


def modules(package):
    """Dotted names of a package's modules; empty files and the command line's start are none."""
    for path in sorted((ROOT / package).rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        if parts[-1] != "__main__" and path.read_text(encoding="utf-8").strip():
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def own_names(module):
    """Public functions and classes of a module, by its source: nothing is imported or compiled."""
    path = ROOT.joinpath(*module.split("."))
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield node.name


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_has_a_docstring(package):
    """By the source, so that names behind a decorator count. A setter's text is its getter's."""
    bare, counted = [], 0
    for path in sorted((ROOT / package).rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if not tree.body:
            continue
        counted += 1
        if not ast.get_docstring(tree):
            bare.append(path.name)
        owners = [tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))]
        for owner in owners:
            if isinstance(owner, ast.ClassDef) and owner.name.startswith("_"):
                continue
            for node in owner.body:
                if not isinstance(node, ast.FunctionDef | ast.ClassDef) or node.name.startswith("_"):
                    continue
                counted += 1
                setter = any(ast.unparse(d).endswith(".setter") for d in node.decorator_list)
                if not ast.get_docstring(node) and not setter:
                    bare.append(f"{path.name}: {node.name}")
    assert counted > 100
    assert not bare


def identifiers(tree):
    """Every identifier of a source, and the words of its strings that are no sentences."""
    for node in ast.walk(tree):
        for field in ("id", "attr", "name", "arg", "module"):
            yield from str(getattr(node, field, None) or "").split(".")
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " not in node.value:
            yield from re.split(r"[^\w]", node.value)


def stale(text, known):
    """Names in single backticks of which a part is nowhere an identifier."""
    names = re.findall(r"(?<!`)`~?([A-Za-z_][\w.]*)`(?!`)", text)
    return [name for name in names if not set(filter(None, name.split("."))) <= known]


def test_names_in_docstrings_and_comments_exist():
    texts = {p: p.read_text(encoding="utf-8") for name in PACKAGES for p in (ROOT / name).rglob("*.py")}
    known = {part for path in texts for part in path.relative_to(ROOT).with_suffix("").parts}
    known |= {each for text in texts.values() for each in identifiers(ast.parse(text))}
    known |= {"run_grpc_proxy_server", "loadmat", "trim_mean", "doStep"}  # of Optuna, SciPy and FMI
    known |= {w for p in (ROOT / "agents").rglob("*.c") for w in re.findall(r"\w+", p.read_text())}
    wrong = {path.name: names for path, text in texts.items() if (names := stale(text, known))}
    assert wrong == {}
    assert stale("see `identifiers`, ``code``, `no_such_name.put`", known | {"identifiers"}) == [
        "no_such_name.put"
    ]


# Generated pages


def test_generated_pages_are_current(generator):
    for path, text in generator["pages"]().items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name}: run python docs/generate.py"


def test_every_module_is_on_an_api_page(generator):
    for package in PACKAGES:
        page = (DOCS / "api" / f"{package}.md").read_text(encoding="utf-8")
        listed = re.findall(r"^::: ([\w.]+)$", page, re.MULTILINE)
        assert sorted(listed) == sorted(modules(package))


def test_the_field_table_says_a_unit_for_nearly_every_number(generator):
    """A field's comment carries it, and the table's third column is that comment."""
    page = (DOCS / "reference" / "scenarios.md").read_text(encoding="utf-8")
    linear = page.split("## linear\n")[1].split("\n## ")[0]
    rows = [line.split(" | ") for line in linear.splitlines() if line.startswith("| `")]
    silent = [row[0] for row in rows if re.fullmatch(r"[\d.e+-]+|inf", row[1]) and "[" not in row[2]]
    assert len(rows) > 60
    assert {name.strip("| `") for name in silent} <= {"nonlinearity.valve.dead_band", "sensing.history"}


@pytest.mark.parametrize("name", ["scenarios", "columns", "controllers"])
def test_no_meaning_is_empty(name):
    """The last column of a generated table: a field's comment, a column's or a controller's words."""
    rows = [line for line in page(name).splitlines() if line.startswith("| `")]
    last = "tuned" if name == "controllers" else ""  # nothing is tuned for some
    heading = ""
    for line in page(name).splitlines():
        if line.startswith("| ") and not line.startswith("| `") and "---" not in line:
            heading = line
        if line.startswith("| `") and not (last and heading.endswith(f"{last} |")):
            assert not re.search(r"\|\s*\|$", line), line
    assert len(rows) > 15


def page(name):
    return (DOCS / "reference" / f"{name}.md").read_text(encoding="utf-8")


# Commands


def commands():
    """Every line that begins with ``shake``, in shell blocks and in blocks indented by four blanks."""
    found = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        shell = "\n".join(re.findall(r"```sh\n(.*?)```", text, re.DOTALL))
        indented = "\n".join(line[4:] for line in text.splitlines() if line.startswith("    shake "))
        for line in re.sub(r"\\\n\s*", " ", f"{shell}\n{indented}").splitlines():
            start = re.search(r"(?:^|[\s/])shake (?=[a-z])", line)
            if start is None or line.lstrip().startswith("#"):
                continue
            words = shlex.split(line[start.end() :].strip(), comments=True)
            for stop in (">", "|"):
                words = words[: words.index(stop)] if stop in words else words
            found.setdefault(tuple(words), page.name)
    return found


LINES = commands()


def parsed(words):
    # {} and $NAME stand for a number, a folder or a file in loops and batch scripts.
    words = [re.sub(r"\{\}|\$\w+", "0", word) for word in words]
    return parse(words)


def test_the_pages_name_every_command():
    assert {words[0] for words in LINES} == set(COMMANDS)
    assert len(LINES) > 40


FILES_PAGE = DOCS / "howto" / "files.md"


@pytest.fixture(scope="module")
def laid_out(tmp_path_factory):
    """A folder with the files that the pages name: those that a page shows, a record, a scenario."""
    folder = tmp_path_factory.mktemp("files")
    for page in PAGES:
        shown = page.read_text(encoding="utf-8")
        for name, text in re.findall(r'```toml title="([\w.]+)"\n(.*?)```', shown, re.DOTALL):
            (folder / name).write_text(text, encoding="utf-8")
    shutil.copy(RECORD, folder / "CICLC.v1")
    scenario = make_scenario("laboratory")
    text = json.dumps({"fields": scenario_fields(scenario)})
    (folder / "mine.json").write_text(text, encoding="utf-8")
    write_scenario(scenario, folder / "mine.toml")
    return folder


@pytest.mark.parametrize("words", LINES, ids=lambda words: " ".join(words)[:60])
def test_every_command_line_is_understood(words, laid_out, monkeypatch):
    """Parsed by the command line itself; a scenario is built as well, with what --set changes."""
    monkeypatch.chdir(laid_out)
    uppercase = {"NAME": "linear", "CONTROLLER": "tvc", "SCENARIO": "laboratory", "FILE": "x.at2"}
    command = parsed([uppercase.get(word, word) for word in words])
    options = getattr(command, "scenario", None)
    if hasattr(options, "build"):
        options.build()


def test_a_mistaken_option_is_not_understood(capsys):
    with pytest.raises(SystemExit):
        parsed(["compare", "--storeys", "5"])
    capsys.readouterr()


CHEAP = ("design", "scenario", "motion")


def runnable(words):
    """Whether a line runs here: not with a placeholder, nor on a record that only the reader has."""
    own = words[0] == "motion" and words[1] != "CICLC.v1"
    long = words[0] == "design" and "test.toml" in words  # the slow suite runs it
    return words[0] in CHEAP and "NAME" not in words and not own and not long


@pytest.mark.parametrize("words", [*filter(runnable, LINES)], ids=lambda w: " ".join(w)[:60])
def test_cheap_commands_run(words, laid_out, tmp_path, monkeypatch, capsys):
    shutil.copytree(laid_out, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    quiet = [] if "--json" in words else ["--json"]  # draws no figure
    assert main([*words, *quiet]) == 0
    assert capsys.readouterr().out.startswith("{")


# Files of a test


def test_the_files_of_the_page_are_the_test_that_it_describes(laid_out):
    scenario = make_scenario(laid_out / "test.toml")
    assert scenario.actuator.table_mass == 420.0 and scenario.specimen.stories == 3
    assert scenario.motion.record.name == "CICLC channel 2 (360 Deg)" and scenario.motion.amplitude < 1.0
    assert scenario.delay == 3 and scenario.limits.table_displacement == 0.11
    noise = {sensor.signal: sensor.noise for sensor in scenario.sensing.sensors}
    assert (
        noise["table_displacement"] == 5e-5 and noise["load_pressure"] == 21e3
    )  # the latter of the base
    for part in ("table", "specimen", "sensors"):
        assert make_scenario(laid_out / f"{part}.toml").name == part


def test_every_other_part_of_a_file_on_the_page_can_be_read(laid_out):
    page = FILES_PAGE.read_text(encoding="utf-8")
    texts = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    assert len(texts) >= 2
    for text in texts:
        parse_toml(laid_out / "part.toml", f"schema = 1\n{text}")


@pytest.mark.slow
def test_the_commands_of_the_page_on_files_run_as_they_stand(laid_out, tmp_path, monkeypatch, capsys):
    """A report on a table, a specimen and a record of one's own, without a line of Python."""
    shutil.copytree(laid_out, tmp_path, dirs_exist_ok=True)
    (tmp_path / "mine.toml").unlink()
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```sh\n(.*?)```", FILES_PAGE.read_text(encoding="utf-8"), re.DOTALL)
    for line in "".join(blocks).splitlines():
        assert main(shlex.split(line)[1:]) == 0, line
    capsys.readouterr()
    assert "CICLC channel 2" in (tmp_path / "out" / "report" / "index.html").read_text(encoding="utf-8")
    assert make_scenario("mine.toml") == make_scenario("laboratory", {"delay": 3.0})
    assert make_scenario("whole.toml") == make_scenario("laboratory")
