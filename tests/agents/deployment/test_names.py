"""Names of exports: those that differ in supervisor, precision or kind are linked into one program."""

import shutil
import subprocess
from itertools import combinations

import numpy as np
import pytest

from agents.deployment.compiled import CompiledProgram, run_compiler
from agents.deployment.controller_program import controller_program, usual_prefix
from agents.deployment.export import export_c
from agents.deployment.plant import plant_program
from shake_env import make_scenario

PERIODS = 20
MAIN = """{includes}
#include <stdio.h>
{memories}
int main(void)
{{
{begins}
    for (int k = 0; k < {periods}; k++) {{
{steps}
    }}
    return 0;
}}
"""
STEP = """
        {{
            {name}_real inputs[{NAME}_INPUTS], outputs[{NAME}_OUTPUTS];
            int code;

            for (int i = 0; i < {NAME}_INPUTS; i++) {{
                inputs[i] = ({name}_real)(0.01 * ((7 * i + 3 * k) % 11 - 5));
            }}
            code = {name}_step(&{name}_memory, inputs, outputs);
            printf("%d %.17g\\n", code, (double)outputs[0]);
        }}"""


@pytest.fixture(scope="module")
def programs():
    """Plain, supervised, in single precision, both, and the table, by the folder that each goes to."""
    scenario = make_scenario("laboratory", {"duration": 2.0})
    made = {}
    for supervised in (False, True):
        for precision in ("float64", "float32"):
            kinds = {"supervised": supervised, "precision": precision}
            made[f"{supervised}-{precision}"] = controller_program("pid", scenario, **kinds)[0]
    return scenario, made | {"table": plant_program(scenario)}


def test_no_two_have_a_name_in_common(programs):
    _, made = programs
    assert [program.name for program in made.values()] == [
        "pid_laboratory", "pid_laboratory_float32", "pid_laboratory_supervised",
        "pid_laboratory_supervised_float32", "table_laboratory",
    ]  # fmt: skip


def test_a_run_directory_gives_its_last_name():
    scenario = make_scenario("laboratory")
    assert usual_prefix("runs/mine/", scenario, "float64") == "mine_laboratory"


@pytest.mark.skipif(
    not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no C compiler is installed"
)
def test_all_are_linked_into_one_program_and_decide_as_alone(programs, tmp_path):
    scenario, made = programs
    sources, names = [], []
    for folder, program in made.items():
        if folder == "table":
            written, files = export_c("table", scenario, tmp_path / folder)
        else:
            options = {"supervised": program.accepts_any_input, "precision": program.precision}
            written, files = export_c("pid", scenario, tmp_path / folder, **options)
        assert written.name == program.name
        sources += [file for file in files if file.name == f"{program.name}.c"]
        names.append(program.name)
    main = tmp_path / "main.c"
    text = MAIN.format(
        includes="\n".join(f'#include "{name}.h"' for name in names),
        memories="\n".join(f"static {name}_t {name}_memory;" for name in names),
        begins="\n".join(f"    {name}_init(&{name}_memory);" for name in names),
        steps="\n".join(STEP.format(name=name, NAME=name.upper()) for name in names),
        periods=PERIODS,
    )
    main.write_text(text, encoding="utf-8")
    folders = [f"-I{tmp_path / folder}" for folder in made]
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off", "-O3")
    run_compiler([*strict, *folders, "-o", tmp_path / "both", main, *sources, "-lm"])
    done = subprocess.run([str(tmp_path / "both")], capture_output=True, text=True, check=True)
    rows = np.array([line.split() for line in done.stdout.splitlines()], dtype=float)
    together = rows.reshape(PERIODS, len(made), 2)
    for place, program in enumerate(made.values()):
        alone, size = CompiledProgram(program), len(program.inputs)
        memory = alone.begin(1)
        for k in range(PERIODS):
            given = 0.01 * ((7 * np.arange(size) + 3 * k) % 11 - 5)
            outputs, codes = alone.step(memory, given[None])
            assert tuple(together[k, place]) == (codes[0], outputs[0, 0])
    for one, other in combinations(range(4), 2):  # four controllers, and not one under four names
        assert (together[:, one, 1] != together[:, other, 1]).any()
