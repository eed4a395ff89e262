import ast
import csv
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

import agents.studies.reproduction.run
from agents.studies.reproduction.run import reproduce
from agents.studies.reproduction.tables import (
    PUBLISHED,
    damped_frequencies,
    prescribed_table,
    shear_ratio,
    table_plant,
    unaware_design,
)
from shake_env.model.parameters import Actuator, ModelEquations, Specimen

OMEGA = 2.0 * np.pi * np.array([0.3, 1.0, 4.3, 11.0, 40.0])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reproduction")
    lines = []
    results = reproduce(folder, lines.append, frequency_points=20, sweep_points=3)
    return folder, results, lines


# --- SPEC 3: natural frequencies, feed-through, row 3 of eq. 13


def test_natural_frequencies_of_both_models():
    corrected, printed = table_plant(2, 0.5), table_plant(2, 0.5, ModelEquations.as_printed())
    np.testing.assert_allclose(damped_frequencies(corrected), [4.311, 11.310, 35.245], atol=5.1e-4)
    np.testing.assert_allclose(damped_frequencies(printed), [5.242, 11.508, 34.883], atol=5.1e-4)


def test_undamped_frequencies_are_those_of_the_mass_and_stiffness_model():
    plant = table_plant(2, 0.5)
    a, s = plant.actuator, plant.specimen
    M = np.diag([a.table_mass, *s.masses])
    K = np.zeros((3, 3))
    K[0, 0] = a.oil_stiffness
    for i, k in enumerate(s.stiffnesses):
        K[i : i + 2, i : i + 2] += k * np.array([[1.0, -1.0], [-1.0, 1.0]])
    frequencies = np.sqrt(eigh(K, M, eigvals_only=True)) / (2.0 * np.pi)
    # The first is 4.31048: the reference 4.311 is its rounding up, hence 6e-4 and not 5e-4.
    np.testing.assert_allclose(frequencies, [4.311, 11.309, 35.247], atol=6e-4)
    np.testing.assert_allclose(plant.natural_frequencies, frequencies, rtol=1e-9)


@pytest.mark.parametrize("stories", [2, 5, 10])
def test_row_three_of_the_printed_model(stories):
    printed = table_plant(stories, 0.5, ModelEquations.as_printed())
    corrected = table_plant(stories, 0.5)
    np.testing.assert_allclose(shear_ratio(printed, 0.0, OMEGA), 1.0, rtol=1e-12)
    np.testing.assert_allclose(shear_ratio(printed, 1.0, OMEGA), 2.0, rtol=1e-12)
    np.testing.assert_allclose(shear_ratio(corrected, 0.0, OMEGA), 0.0, atol=1e-12)
    np.testing.assert_allclose(shear_ratio(corrected, 1.0, OMEGA), 1.0, rtol=1e-12)


def test_prescribed_table_has_the_rows_of_the_coupled_plant():
    # The specimen's rows with x_A free must be what the prescribed motion feeds them: no second copy of
    # eq. 13 may drift from the plant's.
    for equations in (ModelEquations.corrected(), ModelEquations.as_printed()):
        plant = table_plant(2, 0.5, equations)
        model, layout = prescribed_table(plant), plant.layout
        x = np.random.default_rng(1).normal(size=layout.order) * plant.state_scale
        y_A, _, target, _ = plant.coupled.C @ x
        expected = (plant.coupled.A @ x)[np.r_[layout.specimen, layout.reference]]
        both = np.r_[x[layout.specimen], x[layout.reference]]
        np.testing.assert_allclose(model.A @ both + model.B @ [y_A, target], expected, rtol=1e-9)


def test_arithmetic_of_table_i():
    assert Actuator().oil_column_frequency == pytest.approx(35.07, abs=0.005)
    assert Actuator().oil_column_damping == pytest.approx(0.0126, abs=0.00005)
    for stories, first in ((2, 4.326), (5, 1.992), (10, 1.046)):
        frequencies = Specimen.uniform(stories=stories).fixed_base_frequencies
        assert frequencies[0] == pytest.approx(first, abs=0.0005)
        assert frequencies[0] == pytest.approx(14.0 * math.sin(math.pi / (4 * stories + 2)), rel=1e-12)


# --- SPEC 4: the design that does not know the specimen

UNAWARE = {
    2: ("0.445 : 0.106", "0.451 : 0.170", "0.478 : 0.347", "0.536 : 0.543", "0.638 : 0.729"),
    10: ("0.439 : 0.126", "0.441 : 0.230", "0.456 : 0.471", "0.497 : 0.687", "0.586 : 0.847"),
}


def _digits(rows):
    return tuple(f"{r['acceleration_error']:.3f} : {r['base_shear_error']:.3f}" for r in rows)


@pytest.mark.parametrize("stories", [2, 10])
def test_design_that_does_not_know_the_specimen(stories):
    assert _digits(unaware_design(stories, (0.1, 0.2, 0.5, 1.0, 2.0), 1e-3)) == UNAWARE[stories]


@pytest.mark.parametrize(("stories", "shear"), [(2, 0.073), (10, 0.033)])
def test_design_that_knows_the_specimen_does_not_mind_its_mass(stories, shear):
    for row in unaware_design(stories, (0.1, 0.2, 0.5, 1.0, 2.0), None):
        assert row["acceleration_error"] == pytest.approx(0.44, abs=0.005)
        assert row["base_shear_error"] == pytest.approx(shear, abs=0.0005)


# --- What the command writes


def test_published_cells():
    assert {table: len(cells) for table, cells in PUBLISHED.items()} == {"II": 9, "III": 9}
    assert PUBLISHED["II"][10, 0.1] == (7.2, 100.0)
    assert PUBLISHED["III"][5, 0.5] == (10.0, 6500.0)


def test_results_agree_with_the_reference_values(run):
    _, results, lines = run
    cells = {(c["table"], c["stories"], c["mass_ratio"]): c for c in results["cells"]}
    assert len(cells) == 18
    for cell in cells.values():
        for column in ("as_printed", "corrected"):
            norms = cell[column]
            assert norms["acceleration"] == pytest.approx(norms["acceleration_by_frequency"], rel=1e-6)
    assert cells["II", 2, 0.5]["corrected"]["base_shear"] == pytest.approx(1.55e-2, abs=5e-5)
    assert cells["II", 5, 0.5]["as_printed"]["base_shear"] == pytest.approx(1.15e6, abs=5e3)
    assert cells["III", 10, 0.1]["as_printed"]["acceleration"] == pytest.approx(9.68, abs=5e-3)
    curve = {(r["acceleration_weight"], r["force_weight"]): r for r in results["trade_off"]["2"]}
    assert curve[1.0, 1.0]["cost"] == pytest.approx(0.208513, abs=5e-7)
    assert curve[1.0, 0.0]["cost"] == pytest.approx(0.199702, abs=5e-7)
    assert curve[0.0, 1.0]["cost"] == pytest.approx(0.009335, abs=5e-7)
    assert len(lines) == 5
    assert all(line.startswith("[") for line in lines)


def test_one_printed_difference_makes_the_contrast(run):
    rows = {r["equations"]: r for r in run[1]["equations"]}
    large = rows["eq. 13: the specimen feels the target too"]["table_II_base_shear"]
    assert large == pytest.approx(rows["as printed (eqs. 3, 5 and 13)"]["table_II_base_shear"], rel=1e-6)
    for name in ("corrected", "eq. 3: f_s pushes the table with -1/m_a", "eq. 5: y_A leaves f_s out"):
        assert rows[name]["table_II_base_shear"] < 1e-6 * large


def test_sweep_starts_at_the_design_without_added_weight(run):
    results = run[1]
    cells = {(c["table"], c["stories"], c["mass_ratio"]): c for c in results["cells"]}
    assert len(results["sweep"]["curves"]) == 36
    for curve in results["sweep"]["curves"]:
        cell = cells[curve["table"], curve["stories"], curve["mass_ratio"]][curve["model"]]
        # The norm moves as the square root of the weight: by 1.3e-2 at 1e-10 and 1.1e-3 here, at 1e-12,
        # in the worst case, which is force weights on ten storeys.
        assert curve["acceleration"][0] == pytest.approx(cell["acceleration"], rel=2e-3)
        assert min(curve["acceleration"]) > 0.0


def test_files_are_complete(run):
    folder, results, _ = run
    names = {Path(f).name for f in results["files"]}
    figures = {
        "figure_3", "figure_4", "added_weight_table_II", "added_weight_table_III", "trade_off",
        "unaware_design",
    }  # fmt: skip
    expected = {f"{f}.{kind}" for f in figures for kind in ("png", "svg")}
    assert names == expected | {"tables_II_and_III.csv", "reproduction.json", "tables.md"}
    for name in names:
        assert (folder / name).stat().st_size > 1000
    stored = json.loads((folder / "reproduction.json").read_text())
    assert stored["cells"] == json.loads(json.dumps(results["cells"]))
    with (folder / "tables_II_and_III.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == 18
    first = next(r for r in rows if (r["table"], r["stories"], r["mass_ratio"]) == ("II", "2", "0.1"))
    assert float(first["published_base_shear_N2"]) == 1e4
    assert float(first["corrected_base_shear_N2"]) == pytest.approx(6.2e-4, abs=5e-6)
    text = (folder / "tables.md").read_text()
    assert "| 2 | without | " + " | ".join(UNAWARE[2]) + " |" in text
    assert "nan" not in text


def test_the_document_holds_the_tables_that_the_command_writes(run):
    written = (run[0] / "tables.md").read_text()
    document = (Path(__file__).parents[3] / "docs" / "reproduction.md").read_text()
    for heading in (
        "## Each printed difference by itself",
        "## 200 Hz LQR that does not know the specimen",
    ):
        section = written.split(heading)[1].split("## ")[0]
        rows = [line for line in section.splitlines() if line.startswith("| ")]
        assert len(rows) >= 7
        for row in rows:
            assert row in document


def test_reproduction_needs_no_learning_library():
    """Neither where its modules are imported, in a process of its own, nor inside their functions."""
    learning = {"torch", "stable_baselines3", "sb3_contrib"}
    files = sorted(Path(agents.studies.reproduction.run.__file__).parent.glob("*.py"))
    assert {"run.py", "tables.py", "figures.py"} <= {file.name for file in files}
    imported = set()
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                imported.add(node.module.split(".")[0])
    assert {"numpy", "shake_env"} <= imported and not imported & learning
    names = ", ".join(f"agents.studies.reproduction.{file.stem}" for file in files)
    code = f"import sys, {names}; print(sorted({learning!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
