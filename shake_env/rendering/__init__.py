"""Pictures of a test: scene, painter, window."""

from shake_env.rendering.window import Window, make_view, metadata

__all__ = [
    "Window",
    "make_view",
    "metadata",
]
