"""What is asked of the fields of a scenario by their paths, such as ``motion.amplitude``, as a tree."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from shake_env.errors import ScenarioError

NOTHING = object()  # value of a field of which only parts are asked
Steps = tuple[str | int, ...]
_STEP = re.compile(r"([^.\[\]]+)|\[(\d{1,6})\]")


class Source(Protocol):
    """A file that fields come from."""

    @property
    def file(self) -> Path:
        """The file."""

    def place(self, steps: Steps) -> str:
        """Return file and line of the field at a path."""


@dataclass
class Node:
    """What is asked of a field: a value of its own, and then of its parts."""

    steps: Steps = ()
    source: Source | None = None
    value: Any = NOTHING
    parts: dict[Any, Node] = field(default_factory=dict)

    @property
    def path(self) -> str:
        """The field's path, such as ``sensing.sensors.load_pressure.noise``."""
        return path_of(self.steps)

    @property
    def place(self) -> str:
        """File, line and path, as far as there are any."""
        if self.source is None:
            return self.path
        where = self.source.place(self.steps)
        return f"{where}, {self.path}" if self.steps else where

    def child(self, step: str | int) -> Node:
        """Return the node of a part, made where there is none."""
        if step not in self.parts:
            self.parts[step] = Node((*self.steps, step), self.source)
        return self.parts[step]

    def nearest(self, path: str) -> Node:
        """Return the deepest node along a path of names below this one."""
        node = self
        for step in re.split(r"[.\[]", path):
            if step not in node.parts:
                break
            node = node.parts[step]
        return node

    def given(self) -> Any:
        """Return what stands at this node, for a message."""
        return {str(name): part.given() for name, part in self.parts.items()} or self.value


def path_of(steps: Iterable[str | int]) -> str:
    """Return a scenario field's path as text: names with dots between them, places in brackets."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in steps).lstrip(".")


def nodes_of(values: Mapping[str, Any], *, once: bool = False) -> Node:
    """Return the tree of what is asked by field paths.

    A mapping asks for fields of a part. A later value replaces what was asked of its parts before.

    Parameters
    ----------
    values
        Path to value.
    once
        Whether a field that is given along with one of its parts is refused.
    """
    root = Node()
    for path, value in values.items():
        steps: Steps = tuple(name or int(number) for name, number in _STEP.findall(path))
        if not steps or path_of(steps) != path:
            raise ScenarioError("field path", path, "must be names with dots between them")
        node = root
        for step in steps:
            if once and node.value is not NOTHING:
                raise ScenarioError("field path", path, "a part of it has a value already: remove one")
            node = node.child(step)
        if once and (node.parts or node.value is not NOTHING):
            raise ScenarioError("field path", path, "has fields of its own already: remove one of them")
        node.parts = {}
        if isinstance(value, Mapping) and not once:
            for step, part in nodes_of(value).parts.items():
                node.parts[step] = _moved(part, node.steps)
        else:
            node.value = value
    return root


def _moved(node: Node, below: Steps) -> Node:
    parts = {step: _moved(part, below) for step, part in node.parts.items()}
    return Node((*below, *node.steps), node.source, node.value, parts)
