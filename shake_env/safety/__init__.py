"""Braking and the supervisor that keeps the hard limits under any controller."""

from shake_env.safety.supervisor import Supervised

__all__ = [
    "Supervised",
]
