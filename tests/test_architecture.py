"""Who may import whom: downwards between rooms, no circle, nothing that a room may not need."""

import ast
import itertools
import sys
from functools import cache
from graphlib import CycleError, TopologicalSorter

import pytest
from module_sources import ROOT, sources

# Rooms from top to bottom: folders, and single files at the top of a package. A module imports from its
# own room and from rooms below it. Rooms on one line do not import one another.
ROOMS = """
    shake_env/command_line
    agents/__main__
    agents/cli
    agents/experiments agents/studies
    agents/motions agents/deployment
    agents/laboratory
    agents/reporting
    agents/acceptance
    agents/training
    agents/evaluation agents/learning
    agents/execution
    agents/policies
    agents/scenario_options agents/figure_style agents/provenance agents/progress
    agents/run_directory
    agents/plain_values agents/seeds agents/earlier_names
    baselines/registry
    baselines/searched_lqg
    baselines/catalogue
    baselines/tuned_values
    baselines/analysis
    baselines/iterative
    baselines/servo
    baselines/planning
    baselines/estimation
    baselines/lqr
    baselines/baseline
    baselines/batch_controllers baselines/information
    shake_env/__init__
    shake_env/vector_env shake_env/sequence_env
    shake_env/env
    shake_env/rendering shake_env/safety
    shake_env/rollout
    shake_env/simulation
    shake_env/scenario
    shake_env/dynamics
    shake_env/kernels
    shake_env/motion
    shake_env/records
    shake_env/model
    shake_env/numba_support shake_env/controller shake_env/lazy
    shake_env/files
    shake_env/errors shake_env/renamed
"""
IMPORTERS = ("import_module", "compiled_module", "__import__", "find_spec")
LEARNING = {"torch", "stable_baselines3", "sb3_contrib", "tensorboard"}
SHOWING = {"matplotlib", "rich", "tyro", "plotly", "jinja2"}
# What a package or room may import besides the standard library and this project. A room's own line
# stands before its package's.
LIBRARIES = {
    "shake_env/kernels": {"numpy", "numba", "llvmlite", "scipy"},
    "shake_env/simulation": {"numpy", "array_api_compat"},
    "shake_env/rendering": {"numpy", "PIL", "pygame", "gymnasium"},
    "shake_env/env": {"numpy", "gymnasium"},
    "shake_env/vector_env": {"numpy", "gymnasium"},
    "shake_env/sequence_env": {"numpy", "gymnasium"},
    "shake_env/__init__": {"gymnasium"},
    "shake_env/numba_support": {"numba"},
    "shake_env/records": {"numpy", "obspy", "h5py", "openpyxl"},
    "shake_env/scenario": {"numpy", "array_api_compat", "tomlkit"},
    "shake_env": {"numpy", "scipy", "array_api_compat"},
    "baselines/planning": {"numpy", "scipy", "numba"},
    "baselines": {"numpy", "scipy", "control", "osqp", "array_api_compat"},
    "agents/policies": {"numpy", "safetensors", "array_api_compat", "onnx", "onnxruntime", "scipy"},
}


def lines():
    return [line.split() for line in ROOMS.splitlines() if line.strip()]


def rank():
    return {room: number for number, rooms in enumerate(reversed(lines())) for room in rooms}


def room(module):
    """The room of a module's dotted name, such as ``shake_env.model.plant``."""
    parts = module.split(".")
    return "/".join(parts[:2]) if len(parts) > 1 else f"{parts[0]}/__init__"


@cache
def imports(text, names=frozenset()):
    """Modules that a source imports anywhere, in functions and by name too.

    `names` are the known modules: ``from package import module`` then counts as the module.
    """
    modules = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                modules.add(whole if whole in names else node.module)
        elif isinstance(node, ast.Call):
            called = getattr(node.func, "attr", getattr(node.func, "id", ""))
            if called in IMPORTERS:
                modules |= {a.value for a in node.args[:1] if isinstance(a, ast.Constant)}
    return modules


# Modules that import by a name that is no literal, which `imports` cannot see, and what they import.
BY_VARIABLE = {
    "agents.cli.commands": "modules of its own table, all in agents.cli",
    "agents.laboratory.logs.hdf5_file": "a library",
    "agents.policies.own_controller": "a module of the user's",
    "baselines.planning.model": "compiled modules of its own room",
    "shake_env.command_line": "nothing: whether a library can be found",
    "shake_env.lazy": "modules of the package that calls it",
    "shake_env.numba_support": "what a caller names in `compiled_module`",
}


def imports_by_variable(text):
    """Lines of a source that import a module by a name that is no literal."""
    return [
        node.lineno
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call)
        and getattr(node.func, "attr", getattr(node.func, "id", "")) in IMPORTERS
        and not (node.args and isinstance(node.args[0], ast.Constant))
    ]


def upward(module, text, names, ranks):
    """Imports of a module that do not lead to its own room or one below it."""
    own = room(module)
    wrong = []
    for each in imports(text, names):
        if each.split(".")[0] not in ("shake_env", "baselines", "agents"):
            continue
        other = room(each)
        # A package's own docstring module holds nothing: importing it is no dependency.
        if other in (own, "baselines/__init__", "agents/__init__"):
            continue
        if not ranks[other] < ranks[own]:
            wrong.append(each)
    return sorted(wrong)


NAMES = frozenset(name for name, _ in sources())
MODULES = [pytest.param(name, path, id=name) for name, path in sources()]


@pytest.mark.parametrize(("module", "path"), MODULES)
def test_imports_lead_downwards(module, path):
    ranks = rank()
    if module in ("baselines", "agents"):
        assert not imports(path.read_text(encoding="utf-8"))
        return
    assert room(module) in ranks, f"{room(module)}: give the room a line in ROOMS"
    assert upward(module, path.read_text(encoding="utf-8"), NAMES, ranks) == []


def test_imports_by_a_variable_are_known():
    texts = {name: path.read_text(encoding="utf-8") for name, path in sources()}
    assert {name for name, text in texts.items() if imports_by_variable(text)} == set(BY_VARIABLE)
    assert imports_by_variable("def f(x):\n    import_module(x)\n    import_module(f'agents.{x}')") == [
        2,
        3,
    ]


def circle(edges):
    """The first circle of a graph given as pairs, as a text; empty: there is none."""
    graph = {}
    for start, end in edges:
        graph.setdefault(start, set()).add(end)
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return " -> ".join(error.args[1])
    return ""


def folder_edges(pairs):
    """Imports between folders of which none holds the other, given imports between modules."""
    folders = {(a.rpartition(".")[0], b.rpartition(".")[0]) for a, b in pairs}
    return {
        (a, b) for a, b in folders if not f"{a}.".startswith(f"{b}.") and not f"{b}.".startswith(f"{a}.")
    }


def test_no_circle_of_folders():
    """Also between the folders of one room, which the table of rooms does not order."""
    pairs = {
        (name, each)
        for name, path in sources()
        if path.name != "__init__.py"
        for each in imports(path.read_text(encoding="utf-8"), NAMES) & NAMES
        if name.count(".") > 1 and each.count(".") > 1  # single files of a package have lines in ROOMS
    }
    assert circle(folder_edges(pairs)) == ""
    logs, fit = "agents.laboratory.logs.raw", "agents.laboratory.identification.fit"
    assert "laboratory.logs" in circle(folder_edges(pairs | {(logs, fit)}))


def test_no_circle_of_modules():
    graph = {
        name: (imports(path.read_text(encoding="utf-8"), NAMES) & NAMES) - {name}
        for name, path in sources()
        if path.name != "__init__.py"  # holds names of its modules, which never ask for it
    }
    assert circle((name, each) for name, others in graph.items() for each in others) == ""


def test_modules_of_a_package_import_from_modules_and_not_from_its_front():
    fronts = {name for name, path in sources() if path.name == "__init__.py"}
    for name, path in sources():
        for each in imports(path.read_text(encoding="utf-8"), NAMES) & fronts:
            assert not (name + ".").startswith(each + "."), f"{name} imports {each}"


@pytest.mark.parametrize(("module", "path"), MODULES)
def test_libraries_are_those_of_the_room(module, path):
    allowed = LIBRARIES.get(room(module), LIBRARIES.get(module.split(".")[0]))
    outside = {name.split(".")[0] for name in imports(path.read_text(encoding="utf-8"))}
    outside -= {"shake_env", "baselines", "agents"} | sys.stdlib_module_names
    if allowed is None:  # the rest of agents
        assert "control" not in outside, "control design belongs in baselines"
    else:
        assert outside <= allowed


def arrows(picture):
    """Pairs of names that arrows of a mermaid flowchart join, ``a & b --> c --> d`` taken apart."""
    for line in picture.splitlines():
        groups = [[name.strip() for name in part.split("&")] for part in line.split("-->")]
        for above, below in itertools.pairwise(groups):
            yield from itertools.product(above, below)


def test_the_picture_of_the_rooms_is_that_of_the_table():
    """Every arrow leads downwards in ROOMS, and every folder is in the picture."""
    text = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    ranks, pairs = rank(), list(arrows(text.split("```mermaid")[1].split("```")[0]))
    rooms = {
        name: {room for room in ranks if room.endswith(f"/{name}")} for pair in pairs for name in pair
    }
    for above, below in pairs:
        assert rooms[above] and rooms[below], (above, below)
        assert min(ranks[a] for a in rooms[above]) > min(ranks[b] for b in rooms[below]), (above, below)
    folders = {room for room in ranks if (ROOT / room).is_dir()}
    assert folders <= set().union(*rooms.values())


@pytest.mark.parametrize("entry", ["agents.policies", "shake_env", "baselines"])
def test_what_a_deployed_controller_needs_imports_neither_learning_nor_drawing(entry):
    """Everything that a room's modules reach, by any import that runs when they are imported."""
    graph = {name: imports(path.read_text(encoding="utf-8"), NAMES) for name, path in sources()}
    del graph["shake_env.command_line"]  # the entry point of the command line, which imports it all
    queue = [name for name in graph if name == entry or name.startswith(entry + ".")]
    assert len(queue) > 5
    reached = set(queue)
    while queue:
        for each in graph[queue.pop()]:
            assert each.split(".")[0] not in LEARNING | SHOWING, each
            if each in graph and each not in reached:
                reached.add(each)
                queue.append(each)


def users_of_studies(texts):
    """Modules outside of `agents.studies` that import it, given texts by module."""
    return {
        name
        for name, text in texts.items()
        if not name.startswith("agents.studies")
        and any(each.startswith("agents.studies") for each in imports(text, NAMES))
    }


def test_studies_stand_apart_from_all_but_their_commands():
    texts = {name: path.read_text(encoding="utf-8") for name, path in sources()}
    commands = ("adaptation", "gradient_noise", "plot_components", "reproduce", "validate_transients")
    assert users_of_studies(texts) == {f"agents.cli.studies.{name}" for name in commands}
    wrong = {"agents.motions.figure": "def f():\n    from agents.studies.validation import run"}
    assert users_of_studies(wrong) == set(wrong)


def test_a_folder_has_at_most_twenty_files():
    for package in ("shake_env", "baselines", "agents", "tests"):
        for folder in [ROOT / package, *(p for p in (ROOT / package).rglob("*") if p.is_dir())]:
            files = [p for p in folder.glob("*.py") if p.name != "__init__.py"]
            assert len(files) <= 20, folder.relative_to(ROOT)


def test_the_folders_of_tests_are_those_of_the_packages():
    """The tests of a folder are in its namesake, or in that of the folder above it."""
    for package in ("shake_env", "baselines", "agents"):
        folders = {p.relative_to(ROOT) for p in (ROOT / package).rglob("*") if any(p.glob("*.py"))}
        tested = {
            p.relative_to(ROOT / "tests")
            for p in (ROOT / "tests" / package).rglob("*")
            if any(p.glob("*.py"))
        }
        assert tested <= folders
        assert all({folder, folder.parent} & tested for folder in folders)


@pytest.mark.parametrize(
    ("module", "text"),
    [
        ("shake_env.model.plant", "from baselines.lqr.sampled import lqr"),
        ("shake_env.model.plant", "def f():\n    from shake_env.scenario.scenario import Scenario"),
        ("shake_env.model.plant", "import importlib\nimportlib.import_module('baselines.registry')"),
        ("shake_env.dynamics.linear", "x = compiled_module('shake_env.simulation.compiled_engine')"),
        ("agents.policies.policy_file", "from agents.training import train"),
        ("baselines.lqr.preview", "import agents.cli.compare"),
    ],
)
def test_the_rule_sees_a_wrong_import(module, text):
    assert upward(module, text, NAMES, rank())


@pytest.mark.parametrize(
    ("module", "text"),
    [
        ("shake_env.simulation.simulation", "from shake_env.model.plant import CoupledPlant"),
        ("agents.cli.compare", "def f():\n    import agents.training.run"),
        ("shake_env.dynamics.linear", "compiled_module('shake_env.kernels.table')"),
    ],
)
def test_the_rule_lets_a_right_import_pass(module, text):
    assert upward(module, text, NAMES, rank()) == []
