"""A program as C99: header, source, test with recorded periods, Makefile; from templates."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np

from agents.deployment.program import Block, Precision, Program
from shake_env.files import write_text
from shake_env.model.parameters import FloatArray

FOLDER = Path(__file__).parent / "templates"
WIDTH = 100  # of a line of constants
# Largest difference between recorded and computed outputs, over their range, that the test program
# allows: outputs are recorded as Python gives them, in float32.
TOLERANCE: Mapping[Precision, float] = {"float64": 1e-6, "float32": 1e-4}


def c_number(value: float, precision: Precision = "float64") -> str:
    """Return a number as a C constant that has exactly its value in that precision."""
    value = float(value)
    if not math.isfinite(value):
        raise AssertionError(f"a constant of a program is {value}")
    single = precision == "float32"
    text = repr(float(np.float32(value))) if single else repr(value)
    if single:
        text = np.format_float_scientific(np.float32(value), unique=True, trim="0")
    text = text if re.search(r"[.e]", text) else f"{text}.0"
    return f"{text}F" if single else text


def template_environment(precision: Precision) -> jinja2.Environment:
    """Return the templates; the filter `real` writes a number, `exact` one in double."""
    made = jinja2.Environment(
        loader=jinja2.FileSystemLoader(FOLDER),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,
    )
    made.filters["real"] = lambda value: c_number(value, precision)
    made.filters["exact"] = c_number
    made.globals["product"] = _product
    return made


def _product(block: Mapping[str, Any], name: str, vector: str, result: str) -> str:
    """Return the call that multiplies a block's matrix by a vector; a sparse one without its zeros."""
    matrix = f"{block['name']}_{name}"
    rows, columns = block[name].shape
    if name in block["sparse"]:
        return f"sparse_product({matrix}, {matrix}_columns, {matrix}_ends, {rows}, {vector}, {result});"
    return f"product({matrix}, {rows}, {columns}, {vector}, {result});"


def render_program(program: Program) -> dict[str, str]:
    """Return the texts of header and source by file name."""
    env = template_environment(program.precision)
    blocks = _blocks(env, program)
    code = "\n".join(block["code"] for block in blocks)
    context = {
        "name": program.name,
        "NAME": program.name.upper(),
        "title": program.title,
        "inputs": program.inputs,
        "outputs": program.outputs,
        "period": repr(program.period),
        "provenance": program.provenance,
        "blocks": blocks,
        "helpers": _helpers(env, program, code),
        "accepts_any_input": program.accepts_any_input,
        "rounds_inputs": program.rounds_inputs,
        "c_type": "double" if program.precision == "float64" else "float",
    }
    return {
        f"{program.name}.h": tidy(env.get_template("program.h").render(context)),
        f"{program.name}.c": tidy(env.get_template("program.c").render(context)),
    }


def write_program(
    program: Program,
    folder: str | os.PathLike[str],
    inputs: FloatArray,
    outputs: FloatArray,
    udp: Mapping[str, Any] | None = None,
) -> list[Path]:
    """Write a program with its test and Makefile into a folder; return the files.

    Parameters
    ----------
    program
        What is written.
    folder
        Where; files of the same name are replaced.
    inputs, outputs
        (periods, inputs) and (periods, outputs) of a test from its start, over their scales, as Python
        has them.
    udp
        Numbers of the datagram (`agents.deployment.rehearsal.datagram`); None: no program for UDP.
    """
    folder, env = Path(folder), template_environment(program.precision)
    texts = render_program(program)
    context = {
        "name": program.name,
        "NAME": program.name.upper(),
        "tolerance": repr(TOLERANCE[program.precision]),
        "has_udp": udp is not None,
        "periods": len(inputs),
        "inputs": _rows(inputs),
        "outputs": _rows(outputs),
        **(udp or {}),
    }
    for template, name in (
        ("test.c", f"{program.name}_test.c"), ("recorded.h", f"{program.name}_recorded.h"),
        ("Makefile", "Makefile"), *([("udp.c", f"{program.name}_udp.c")] if udp is not None else []),
    ):  # fmt: skip
        texts[name] = env.get_template(template).render(context)
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _rows(values: FloatArray) -> list[str]:
    return [", ".join(c_number(value) for value in row) for row in values]


def _blocks(env: jinja2.Environment, program: Program) -> list[dict[str, Any]]:
    """Return what the templates know of each block, innermost first, with its texts."""
    made: list[dict[str, Any]] = []
    for block in program.block.chain:
        facts: dict[str, Any] = {
            **{name: np.asarray(array) for name, array in block.arrays.items()},
            **block.numbers,
            "name": block.kind,
            "kind": block.kind,
            "type": f"{program.name}_{block.kind}_t",
            "summary": block.summary,
            "inner": made[-1] if made else None,
            "sparse": block.sparse,
        }
        module = env.get_template(f"blocks/{block.kind}.c").make_module({})
        facts["state"] = module.state(facts).replace(" real ", f" {program.name}_real ")  # type: ignore[attr-defined]
        before = module.before(facts) if hasattr(module, "before") else ""
        facts["code"] = before + module.code(facts)  # type: ignore[attr-defined]
        facts["constants"] = _constants(block, program.precision)
        made.append(facts)
    return made


def _constants(block: Block, precision: Precision) -> str:
    arrays, integers = dict(block.arrays), dict(block.integers)
    for name in block.sparse:
        matrix = np.asarray(block.arrays[name])
        rows, columns = np.nonzero(matrix)
        arrays[name] = matrix[rows, columns]
        integers[f"{name}_columns"] = columns.tolist()
        integers[f"{name}_ends"] = np.cumsum(np.count_nonzero(matrix, axis=1)).tolist()
    texts = [
        _constant(
            "real", f"{block.kind}_{name}", [c_number(value, precision) for value in array.ravel()]
        )
        for name, array in arrays.items()
        if array.size
    ]
    texts += [_constant("int", f"{block.kind}_{name}", values) for name, values in integers.items()]
    return "\n".join(texts)


def _constant(c_type: str, name: str, values: Sequence[Any]) -> str:
    lines, line = [], "   "
    for value in values:
        text = f" {value},"
        if len(line) + len(text) > WIDTH:
            lines.append(line)
            line = "   "
        line += text
    body = "\n".join([*lines, line])
    return f"static const {c_type} {name}[{len(values)}] = {{\n{body}\n}};\n"


@lru_cache(maxsize=2)
def _helper_sources(precision: Precision) -> dict[str, str]:
    """Return the small functions that blocks share, by name."""
    text = (
        template_environment(precision).get_template("helpers.c").render(single=precision == "float32")
    )
    parts = re.split(r"^/\*\* (\w+) \*/\n", text, flags=re.MULTILINE)[1:]
    return dict(zip(parts[::2], parts[1::2], strict=True))


def _helpers(env: jinja2.Environment, program: Program, code: str) -> list[str]:
    """Return those helpers that the code uses, in an order in which each knows its own."""
    sources = dict(_helper_sources(program.precision))
    if program.valve is not None:
        sources["valve_opening"] = env.get_template("valve.c").render(program.valve)
    used: set[str] = set()
    queue = [code]
    while queue:
        text = queue.pop()
        for name, source in sources.items():
            if name not in used and re.search(rf"\b{name}\(", text):
                used.add(name)
                queue.append(source)
    return [source.strip() + "\n" for name, source in sources.items() if name in used]


def tidy(text: str) -> str:
    """Return a text without blank lines in a row or at the ends of blocks."""
    text = re.sub(r"\n{3,}", "\n\n", text)
    text = re.sub(r"\n\n(\s*})", r"\n\1", text)
    return re.sub(r"[ \t]+\n", "\n", text).strip() + "\n"
