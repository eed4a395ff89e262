"""Who may import whom, downwards only."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LEARNING = {"torch", "stable_baselines3", "sb3_contrib", "tensorboard"}
DRAWING = {"matplotlib", "rich", "tyro"}
GYMNASIUM = {"__init__.py", "env.py", "vector_env.py", "rendering.py"}
# Within shake_env, lowest first: a module imports from lower ranks only, or its own where listed.
LAYERS = [
    {"errors", "controller", "compilation"},
    {"inputs"},
    {"ranges"},
    {"parameters", "command_line"},
    {"plant", "records", "rest", "interventions"},
    {"discretization", "motion", "objective", "limits", "nonlinearity", "sensing", "uncertainty"},
    {"dynamics", "preparation", "fields", "block_kernel"},
    {"compiled", "ground_kernel", "adjoint_kernel", "normal_kernel"},
    {"adjoint"},
    {"nonlinear_dynamics", "resolution"},
    {"reference", "normals"},
    {"measurement"},
    {"ground"},
    {"excitation"},
    {"scenario"},
    {"named", "braking", "scenario_file", "capacity", "memory", "sensor_faults"},
    {"overrides", "scenario_digest", "table_state_observer"},
    {"supervisor"},
    {"transition"},
    {"fleet", "packing"},
    {"fused"},
    {"engine"},
    {"simulation"},
    {"metrics", "trajectory", "scene", "pen"},
    {"drawing"},
    {"rendering"},
    {"rollout", "env"},
    {"vector_env"},
]


def sources(package):
    return sorted((ROOT / package).rglob("*.py"))


def imports(path, top_level_only=False):
    """Absolute names of the modules that a file imports anywhere in it, functions included."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            found.add(node.module)
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
    return {name.split(".")[0] for name in found} if top_level_only else found


def files(*packages):
    return [
        pytest.param(path, id=str(path.relative_to(ROOT)))
        for package in packages
        for path in sources(package)
    ]


@pytest.mark.parametrize("path", files("shake_env"))
def test_physics_imports_neither_learning_nor_drawing_nor_control(path):
    found = imports(path, top_level_only=True)
    assert not found & (LEARNING | DRAWING | {"control", "agents", "baselines"})
    if path.name not in GYMNASIUM or path.parent.name != "shake_env":
        assert "gymnasium" not in found


@pytest.mark.parametrize("path", files("baselines"))
def test_baselines_import_downwards(path):
    found = imports(path, top_level_only=True)
    assert not found & (LEARNING | DRAWING | {"agents", "gymnasium"})


@pytest.mark.parametrize("path", files("agents"))
def test_agents_leave_control_to_the_baselines(path):
    assert "control" not in imports(path, top_level_only=True)


def test_packages_need_nothing_that_is_not_declared():
    declared = {"numpy", "scipy", "gymnasium", "array_api_compat", "shake_env"}
    compiled = (
        "block_kernel.py",
        "compiled.py",
        "fused.py",
        "ground_kernel.py",
        "adjoint.py",
        "normal_kernel.py",
    )
    optional = {
        "rendering.py": {"pygame"}, "drawing.py": {"PIL"}, "pen.py": {"PIL"},
        **{name: {"numba"} for name in compiled},
    }  # fmt: skip
    for path in sources("shake_env"):
        allowed = declared | optional.get(path.name, set()) | sys.stdlib_module_names
        extra = imports(path, top_level_only=True) - allowed
        assert not extra, path


@pytest.mark.parametrize("path", files("shake_env"))
def test_modules_of_the_physics_import_lower_layers(path):
    module = path.relative_to(ROOT / "shake_env").parts[0].removesuffix(".py")
    if module == "__init__":
        return
    rank = {name: i for i, layer in enumerate(LAYERS) for name in layer}
    assert module in rank, f"{module}: give it a layer"
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "shake_env" or len(parts) < 2 or parts[1] == module:
            continue
        if parts[1] in rank:
            assert rank[parts[1]] < rank[module], f"{module} imports {parts[1]}"


def test_the_rule_can_fail(tmp_path):
    spoilt = tmp_path / "spoilt.py"
    spoilt.write_text("def f():\n    import torch.nn as nn\n    from agents import train\n")
    assert imports(spoilt, top_level_only=True) == {"torch", "agents"}
