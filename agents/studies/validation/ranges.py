"""What a shake table can do, and which response asks for more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from shake_env.model.parameters import FloatArray


@dataclass(frozen=True, kw_only=True)
class PhysicalRange:
    """A quantity with the size it is rated for and the size it cannot or must not exceed."""

    quantity: str
    unit: str  # in which tables give it
    factor: float  # from SI to that unit
    rated: float  # SI
    limit: float  # SI
    reason: str


RANGES: tuple[PhysicalRange, ...] = (
    PhysicalRange(
        quantity="load_pressure", unit="MPa", factor=1e-6, rated=14e6, limit=21e6,
        reason="supply pressure; two thirds of it where the valve's flow gain has fallen to 58 %",
    ),
    PhysicalRange(
        quantity="spool_position", unit="um", factor=1e6, rated=12.5e-6, limit=20e-6,
        reason="travel at the rated current, and at the largest",
    ),
    PhysicalRange(
        quantity="current", unit="mA", factor=1e3, rated=0.025, limit=0.040,
        reason="rated current of the valve, and the largest its amplifier gives",
    ),
    PhysicalRange(
        quantity="table_velocity", unit="m/s", factor=1.0, rated=0.6, limit=0.7,
        reason="flow limit of such a valve",
    ),
    PhysicalRange(
        quantity="table_displacement", unit="mm", factor=1e3, rated=0.070, limit=0.076,
        reason="soft and hard stop of the stroke",
    ),
    PhysicalRange(
        quantity="table_acceleration", unit="m/s^2", factor=1.0, rated=49.0, limit=49.0,
        reason="5 g, where the laboratory's limits end a test",
    ),
    PhysicalRange(
        quantity="storey_drift", unit="mm", factor=1e3, rated=0.005, limit=0.010,
        reason="1 and 2 % of a storey 0.5 m high: an assumption, for the linear specimen never yields",
    ),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Check:
    """One quantity of one response against its range."""

    quantity: str
    unit: str
    peak: float  # in `unit`, like the two that follow
    rated: float
    limit: float
    verdict: str  # "within", "above rated" or "above limit"
    factor_to_rated: float | None  # amplitude factor that brings the peak to the rated size
    factor_to_limit: float | None  # None: the quantity doesn't move


@dataclass(frozen=True, kw_only=True)
class MotionCheck:
    """Every quantity of one response, and the amplitude factor that brings all of them within range."""

    controller: str
    group: str
    motion: str
    checks: tuple[Check, ...]
    factor_to_rated: float  # of the present amplitude, for the table; above 1 is room to spare
    decided_by: str  # the quantity that sets it
    factor_to_limit: float  # likewise, up to the limits
    factor_to_rated_but_stroke: float  # the displacement left out, because nothing holds it
    decided_by_but_stroke: str
    factor_for_specimen: float  # the storey drift alone: it is the specimen's business, not the table's
    acceleration_error: float | None  # rms of y_A - y~ over rms of y~; None: no target
    base_shear_error: float | None  # rms of f_s - f~_s over rms of f~_s
    drift_ratio: float | None  # largest storey drift over the reference specimen's


def check_peaks(peaks: Mapping[str, float]) -> tuple[Check, ...]:
    """Compare peaks (SI, by quantity) with `RANGES`; a quantity that is missing is left out."""
    checks = []
    for known in RANGES:
        if known.quantity not in peaks:
            continue
        peak = float(peaks[known.quantity])
        over_limit, over_rated = not peak <= known.limit, not peak <= known.rated
        checks.append(
            Check(
                quantity=known.quantity,
                unit=known.unit,
                peak=peak * known.factor,
                rated=known.rated * known.factor,
                limit=known.limit * known.factor,
                verdict="above limit" if over_limit else "above rated" if over_rated else "within",
                factor_to_rated=known.rated / peak if peak > 0.0 else None,
                factor_to_limit=known.limit / peak if peak > 0.0 else None,
            )
        )
    return tuple(checks)


def check_motion(
    controller: str, group: str, motion: str, signals: Mapping[str, FloatArray]
) -> MotionCheck:
    """Check one response; every factor holds because a linear response from rest scales with its input.

    Parameters
    ----------
    signals
        (samples,) by the names of `RANGES`, ``target_acceleration``, ``base_shear``,
        ``reference_base_shear`` and ``reference_drift``, SI.
    """
    peaks = {known.quantity: float(np.max(np.abs(signals[known.quantity]))) for known in RANGES}
    checks = check_peaks(peaks)
    still = float(np.finfo(float).max)  # what does not move may be made as large as you like
    rated = {c.quantity: c.factor_to_rated or still for c in checks}
    limit = {c.quantity: c.factor_to_limit or still for c in checks}
    specimen = rated.pop("storey_drift")
    del limit["storey_drift"]
    others = {name: value for name, value in rated.items() if name != "table_displacement"}
    first, second = min(rated, key=lambda n: rated[n]), min(others, key=lambda n: others[n])
    return MotionCheck(
        controller=controller,
        group=group,
        motion=motion,
        checks=checks,
        factor_to_rated=rated[first],
        decided_by=first,
        factor_to_limit=min(limit.values()),
        factor_to_rated_but_stroke=others[second],
        decided_by_but_stroke=second,
        factor_for_specimen=specimen,
        acceleration_error=_ratio(
            signals["table_acceleration"] - signals["target_acceleration"],
            signals["target_acceleration"],
        ),
        base_shear_error=_ratio(
            signals["base_shear"] - signals["reference_base_shear"], signals["reference_base_shear"]
        ),
        drift_ratio=_peak_ratio(signals["storey_drift"], signals["reference_drift"]),
    )


def _ratio(error: FloatArray, signal: FloatArray) -> float | None:
    size = float(np.sqrt(np.mean(signal**2)))
    return float(np.sqrt(np.mean(error**2))) / size if size > 0.0 else None


def _peak_ratio(signal: FloatArray, reference: FloatArray) -> float | None:
    size = float(np.max(np.abs(reference)))
    return float(np.max(np.abs(signal))) / size if size > 0.0 else None
