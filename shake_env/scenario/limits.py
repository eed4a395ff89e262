"""Limits whose breaking ends an episode, and what that costs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import array_api_compat

from shake_env.errors import ParameterError
from shake_env.model.plant import LOAD_PRESSURE, TABLE_DISPLACEMENT, TABLE_VELOCITY
from shake_env.model.ranges import RANGES, check_ranges, is_number

Array = Any  # a numpy array or a torch tensor

OBSERVATION_BOUND = 1e3  # [-] bound of every scaled observation; a table out there has diverged

REASONS = (
    "diverged",
    "table_displacement",
    "table_velocity",
    "load_pressure",
    "table_acceleration",
    "current",
    "specimen_acceleration",
)  # a step's `broken` code minus one is an index into this


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of the table; None switches one off. The default is the paper's linear setting: all off.

    One is always on: an episode ends as "diverged" when a scaled state (other than the position, which
    may drift) leaves ``+-state_limit``, for no finite observation could describe it. Breaking a limit
    costs `cost_factor` times the expected cost of a table that stands still (under the motion's own
    amplitude, or the unit one where that is smaller), for each control period that remains, up to
    `cost_horizon`. Standing still is open to any policy at any time, so that with a
    factor above 1 ending an episode never pays; training under a discount may shorten the horizon to a
    few times the discount's own.

    Soft limits cost before the hard ones end: beyond `soft_share` of a limit each quantity but the
    current adds
    ``soft_weight ((|value| / limit - soft_share) / (1 - soft_share))^2`` to the stage cost.

    Raises
    ------
    ParameterError
        If a limit, factor or horizon is not above zero (the factor: at least 1), or the share not
        between 0 and 1.
    """

    table_displacement: float | None = None  # [m]
    table_velocity: float | None = None  # [m/s]
    load_pressure: float | None = None  # [Pa]
    table_acceleration: float | None = None  # [m/s^2]
    current: float | None = None  # [A] of the controller's command
    specimen_acceleration: float | None = None  # [m/s^2] of any floor, absolute, at the period's end
    soft_share: float = 0.9  # [-] of a hard limit, where its soft limit begins
    soft_weight: float = 0.0  # [-] stage cost at the hard limit; 0: no soft limits
    state_limit: float = OBSERVATION_BOUND  # [-] multiples of CoupledPlant.state_scale
    cost_factor: float = 5.0  # [-]
    cost_horizon: float | None = None  # [s]; None: to the end of the motion

    def __post_init__(self) -> None:
        if not (is_number(self.soft_share) and 0.0 < self.soft_share < 1.0):
            raise ParameterError("soft_share", self.soft_share, "must lie between 0 and 1")
        if not RANGES["Limits"]["cost_factor"].holds(self.cost_factor):
            raise ParameterError(
                "cost_factor",
                self.cost_factor,
                "must be 1 to 1e9: below 1, breaking a limit costs less than going on",
            )
        check_ranges(self)

    @classmethod
    def laboratory(cls) -> Limits:
        """Return the limits of the table of Table I: stroke, flow, supply pressure, 5 g.

        Soft limits begin at 92 % of them: 70 mm of the stroke of 76. The current has none here: the
        amplifier saturates at the action's own bound.
        """
        return cls(
            table_displacement=0.076,
            table_velocity=0.65,
            load_pressure=21e6,
            table_acceleration=49.0,
            specimen_acceleration=98.0,
            soft_share=0.92,
            soft_weight=1.0,
        )

    @classmethod
    def named(cls, name: str) -> Limits:
        """Return the limits called `name`: ``"off"`` or ``"laboratory"``."""
        known: dict[str, Callable[[], Limits]] = {"off": cls, "laboratory": cls.laboratory}
        if name not in known:
            raise ParameterError("limits", name, f"known: {', '.join(sorted(known))}")
        return known[name]()

    @property
    def sees_floors(self) -> bool:
        """Whether a limit needs the floors' accelerations."""
        return self.specimen_acceleration is not None

    def broken(
        self,
        scaled_state: Array,
        state: Array,
        table_acceleration: Array,
        current: Array | None = None,
        floors: Array | None = None,
    ) -> Array:
        """Return 0 where every limit holds, else 1 + the index in `REASONS` of the first broken one.

        Parameters
        ----------
        scaled_state
            (..., 4 + 2 stories) [x_A, x_S] over its scale.
        state
            (..., 4 + 2 stories) in SI.
        table_acceleration
            (..., k) [m/s^2].
        current
            (...) command [A]; needed where it is limited.
        floors
            (..., stories) absolute accelerations of the floors [m/s^2]; needed where they are limited.
        """
        xp = array_api_compat.array_namespace(state)
        size = xp.abs(scaled_state)
        # `not <=`, so that a NaN counts as diverged.
        inside = size <= self.state_limit
        within = xp.all(inside[..., :TABLE_DISPLACEMENT], axis=-1) & xp.all(
            inside[..., TABLE_DISPLACEMENT + 1 :], axis=-1
        )
        code = xp.where(within, 0, 1)
        for number, limit, value in self._checks(state, table_acceleration, current, floors):
            code = xp.where((code == 0) & (value > limit), number, code)
        return code

    def soft_cost(self, state: Array, table_acceleration: Array, floors: Array | None = None) -> Array:
        """Return what the soft limits add to the stage cost (...); arguments as for `broken`."""
        xp = array_api_compat.array_namespace(state)
        total = xp.zeros_like(state[..., 0])
        if self.soft_weight > 0.0:
            span = 1.0 - self.soft_share
            # The current is left out: the stage cost prices it already, up to its limit.
            for _, limit, value in self._checks(state, table_acceleration, None, floors):
                beyond = ((value / limit - self.soft_share) / span).clip(0.0, None)
                total = total + self.soft_weight * beyond**2
        return total

    def _checks(
        self, state: Array, table_acceleration: Array, current: Array | None, floors: Array | None
    ) -> list[tuple[int, float, Array]]:
        """Return (code, limit, size of the quantity) of each limit that is on."""
        xp = array_api_compat.array_namespace(state)
        checks: list[tuple[int, float, Array]] = []
        for number, limit, place in (
            (2, self.table_displacement, TABLE_DISPLACEMENT),
            (3, self.table_velocity, TABLE_VELOCITY),
            (4, self.load_pressure, LOAD_PRESSURE),
        ):
            if limit is not None:
                checks.append((number, limit, xp.abs(state[..., place])))
        if self.table_acceleration is not None:
            checks.append((5, self.table_acceleration, xp.max(xp.abs(table_acceleration), axis=-1)))
        if self.current is not None and current is not None:
            checks.append((6, self.current, xp.abs(current)))
        if self.specimen_acceleration is not None and floors is not None:
            checks.append((7, self.specimen_acceleration, xp.max(xp.abs(floors), axis=-1)))
        return checks
