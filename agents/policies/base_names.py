"""New."""

from __future__ import annotations

from typing import Literal

BaseLaw = Literal["none", "flow", "lqr", "preview-lqr", "lqg", "lqg-accommodating", "free"]
