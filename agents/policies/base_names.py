"""Names of the base controllers that a policy may correct; imports nothing heavy."""

from __future__ import annotations

from typing import Literal

BaseLaw = Literal["none", "flow", "lqr", "preview-lqr", "lqg", "lqg-dac", "lqg-searched"]
