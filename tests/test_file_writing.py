"""Files are written in one place, so that an interruption leaves the old one or the new one."""

import ast
import re

import pytest
from module_sources import sources

# Where a file is opened to be written without `files`, and why that is right.
OTHER_WRITERS = {
    "agents.run_directory": 1,  # a line appended to a file of lines, half a line dropped
    "agents.execution.worker": 1,  # what a call prints goes there while it runs
    "agents.cli.output_path": 1,  # opened to find out whether it can be written; nothing is
}


def writes(text):
    """Calls of a source that write a file: by a method, or by ``open`` with a mode that does."""
    lines = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        owner = getattr(getattr(node.func, "value", None), "id", None)
        texts = [a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str)]
        if name == "open" and owner != "os":
            modes = [each for each in texts if re.fullmatch(r"[rwaxbt+]{1,4}", each)]
            modes += [k.value.value for k in node.keywords if k.arg == "mode"]
            wrong = any(set(mode) & set("wax+") for mode in modes)
        elif name in ("write_text", "write_bytes"):
            wrong = isinstance(node.func, ast.Attribute)  # a path's method
        else:
            wrong = name in (
                "savefig",
                "savez",
                "savez_compressed",
                "savetxt",
                "save_file",
                "to_csv",
                "tofile",
            )
            wrong |= name == "save" and owner in ("np", "torch")
            wrong |= name == "dump" and owner in ("json", "pickle")
        if wrong:
            lines.append((node.lineno, name))
    return lines


def test_files_are_written_in_one_place():
    """An interruption leaves the old file or the new one, and an error names it: see `files`."""
    number = {}
    for name, path in sources():
        lines = writes(path.read_text(encoding="utf-8"))
        if name == "shake_env.files" or not lines:
            continue
        number[name] = len(lines)
        if name not in OTHER_WRITERS:
            text = path.read_text(encoding="utf-8")
            in_memory = text.count("savefig(image,") + len(
                re.findall(r"savez(?:_compressed)?\(held,", text)
            )
            assert len(lines) == in_memory, f"{name}: {lines}"
    assert OTHER_WRITERS.items() <= number.items()


@pytest.mark.parametrize(
    "text",
    [
        "path.write_text(x)",
        "open(path, 'w')",
        "path.open('ab+')",
        "path.open(mode='x')",
        "figure.savefig(path)",
        "np.save(path, x)",
        "np.savez_compressed(path, x=x)",
        "json.dump(x, file)",
    ],
)
def test_the_rule_sees_another_writer(text):
    assert writes(text)
    assert not writes("write_text(path, x), path.open('rb'), json.dumps(x), tarfile.open(name)")
