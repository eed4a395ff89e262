"""What the project set out to reach, beside what was measured, and why a goal that is missed is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.arithmetic import CONTROLLED, FULL


@dataclass(frozen=True, kw_only=True)
class Goal:
    """One goal and what was found."""

    what: str
    bound: float
    found: float
    at_least: bool = True
    unit: str = "times"
    why: str = ""  # said where it is missed

    @property
    def met(self) -> bool:
        """Whether the goal is reached."""
        return self.found >= self.bound if self.at_least else self.found <= self.bound

    def row(self) -> str:
        """Return the row of a Markdown table."""
        word = "at least" if self.at_least else "at most"
        ratio = f"{self.found / self.bound:.2f}" if self.bound else "-"
        verdict = "yes" if self.met else "**no**"
        return (
            f"| {self.what} | {word} {number(self.bound)} {self.unit} | {number(self.found)} | {ratio} "
            f"| {verdict} |"
        )


def number(value: float) -> str:
    """Return a number in three digits, grouped where it is large."""
    if value and not 1e-3 <= abs(value) < 1e9:
        return f"{value:.1e}"
    digits = next((d for bound, d in ((99.5, 0), (9.995, 1), (0.0995, 2)) if abs(value) >= bound), 4)
    text = f"{value:,.{digits}f}".replace(",", " ")
    return text.rstrip("0").rstrip(".") if "." in text else text


SINGLE = (
    "A step of CartPole is some twenty operations on python floats and takes 6 us, of which Gymnasium's "
    "wrappers and the call take 1. Of ours, 3.9 us undisturbed, a compiled call takes 1.6, of which 0.5 "
    "hand over its arguments and 0.4 read what it reports; the ground takes 0.6, and the rest are the "
    "wrappers, the check of the action and `info`. Two and a half times CartPole's speed were 2.4 us."
)
LABORATORY = (
    "Five physics steps of a laboratory period, each with two evaluations of friction, valve and stops "
    "in float64, take 1.4 us beside what a linear step costs."
)
VECTOR = (
    "Vectorised CartPole steps four float32 states with one explicit step and no random numbers: 85 ns "
    "a table at 1024 tables, so that four times its speed were 21 ns. Drawing a table's ten normal "
    "numbers alone takes as long as CartPole's step; cost, limits and 26 observed numbers twice that."
)
WIDE_LABORATORY = (
    "1.5 million a second are 670 ns a table: 250 to 300 go into the compiled step's five physics "
    "steps, 100 to 150 into the normal numbers of ground and sensors, 60 to 110 into the ground filter "
    "and the reference specimen."
)
GYMNAX = (
    "gymnax steps four float32 states once a table, in 0.3 us of a call for 1024; of ours two fifths "
    "are the update with its cost, limits and observations, a fifth random numbers, a quarter the "
    "ground filter and the reference specimen, and the rest the arrays handed out."
)
TEXTBOOK = (
    "Blocks of nine take 98 multiply-adds a sample, 20 ms at the machine's peak, which products of 40 "
    "rows reach; the squares take 5 more and the inputs' way into the products 3. A tenth of the "
    "textbook's time is about what that makes: 30."
)
PPO_ROLLOUT = (
    "A roll-out's other work is a pass of two networks and SB3's bookkeeping, some hundred operations "
    "of torch and numpy at a few us each: 400 us. A tenth of the whole leaves 45 us for 64 tables, 0.7 "
    "us each."
)
PPO_ALL = (
    "An update of two networks of 64 x 64 by ten passes over the 8192 samples of a roll-out takes 0.2 "
    "to 0.3 s; 2 % of that leaves 0.6 us for a sample's step, and at 64 tables a linear one takes 0.8 "
    "as SB3 asks for it. Behind an estimator, whose batch is numpy's, it is more."
)
DUMMY = (
    "SB3's DummyVecEnv steps CartPole in 9 us an environment, of which a fortieth is 0.22 us; a table "
    "in a batch of 64 takes 0.6 to 0.8, for random numbers, the update, and 64 dictionaries, copies "
    "and casts that SB3's interface asks for."
)


def goals(found: dict[str, Any]) -> list[Goal]:
    """Return the goals of every group that was measured."""
    groups = {
        "single": _single, "vector": _vector, "peers": _peers, "arithmetic": _arithmetic,
        "closed loops": _closed_loops, "learning": _learning, "decision": _decision,
        "footprint": _footprint,
    }  # fmt: skip
    return [goal for name, group in groups.items() if name in found for goal in group(found[name])]


def _single(rates: dict[str, float]) -> Iterator[Goal]:
    cart = rates["CartPole-v1"]
    linear, laboratory = rates["linear, n_m = 5"] / cart, rates["laboratory"] / cart
    tall = rates["linear, n_m = 2"] / rates["linear, n_m = 10"]
    yield Goal(what="one linear table beside CartPole-v1", bound=2.5, found=linear, why=SINGLE)
    yield Goal(what="cost of 10 storeys beside 2", bound=1.2, found=tall, at_least=False)
    yield Goal(what="one laboratory beside CartPole-v1", bound=1.0, found=laboratory, why=LABORATORY)


def _vector(found: dict[str, dict[str, float]]) -> Iterator[Goal]:
    for tables, rates in found.items():
        ratio = rates["linear"] / rates["CartPole-v1"]
        what = f"{tables}, linear, beside vectorised CartPole"
        yield Goal(what=what, bound=4.0, found=ratio, why=VECTOR)
    sb3 = found["64 tables"]
    ratio = sb3["linear, SB3 VecEnv"] / sb3["CartPole-v1, SB3 DummyVecEnv"]
    yield Goal(
        what="64 tables for SB3 beside DummyVecEnv of CartPole", bound=40.0, found=ratio, why=DUMMY
    )
    wide = found["1024 tables"]
    yield Goal(
        what="1024 tables, laboratory",
        bound=1.5e6,
        found=wide["laboratory"],
        unit="table-steps/s",
        why=WIDE_LABORATORY,
    )
    each = wide["laboratory"] / wide["laboratory, a specimen each"]
    yield Goal(what="cost of a specimen each", bound=2.0, found=each, at_least=False)


def _peers(found: dict[str, Any]) -> Iterator[Goal]:
    for tables, rates in found.items():
        if tables == "unavailable":
            return
        ratio = rates["linear"] / rates["gymnax CartPole-v1, stepped"]
        what = f"{tables}, linear, beside gymnax CartPole under jit"
        yield Goal(what=what, bound=1.0, found=ratio, why=GYMNAX)


def _arithmetic(rates: dict[str, float]) -> Iterator[Goal]:
    peak = rates["matrix product 768 x 768"]
    for name in (CONTROLLED, FULL):
        what = f"1024 tables, {name}: peak of matrix products beside it"
        yield Goal(what=what, bound=2.5, found=peak / rates[name], at_least=False)


def _closed_loops(found: dict[str, float]) -> Iterator[Goal]:
    for name, bound in (("textbook batch", 10.0), ("scipy dlsim", 300.0)):
        ratio = found[name] / found["blocks"]
        yield Goal(
            what=f"closed loops in blocks beside a {name}",
            bound=bound,
            found=ratio,
            why=TEXTBOOK if name == "textbook batch" else "",
        )
    apart = found["largest relative difference"]
    yield Goal(what="their largest difference", bound=1e-10, found=apart, at_least=False, unit="")


def _learning(found: dict[str, Any]) -> Iterator[Goal]:
    for name, shares in found["PPO"].items():
        rollout, whole = 100.0 * shares["share of roll-outs"], 100.0 * shares["share of all"]
        what = f"PPO, 64 tables, {name}: stepping, of roll-outs"
        yield Goal(what=what, bound=10.0, found=rollout, at_least=False, unit="%", why=PPO_ROLLOUT)
        what = f"PPO, 64 tables, {name}: stepping, of all time"
        yield Goal(what=what, bound=2.0, found=whole, at_least=False, unit="%", why=PPO_ALL)
    for name, ways in found["gradient"].items():
        grows = ways["gradient"]["exponent of memory"]
        if grows is not None:
            what = f"{name}: memory of a gradient grows as the window to the"
            # Linear; a fixed cost at the smallest windows, or pages of memory, tilt the fit a little.
            yield Goal(what=what, bound=1.1, found=grows, at_least=False, unit="")


def _decision(found: dict[str, dict[str, float]]) -> Iterator[Goal]:
    for name, times in found.items():
        ratio = times["SB3"] / times["numpy"]
        yield Goal(what=f"decision of {name}, beside SB3's predict", bound=1.0, found=ratio)


def _footprint(found: dict[str, Any]) -> Iterator[Goal]:
    taken, memory = found["import [s]"], found["4096 tables, 60 s motions [GiB]"]
    torch = float(found["torch imported"])
    yield Goal(what="import beyond what it needs", bound=0.5, found=taken, at_least=False, unit="s")
    yield Goal(what="imports of torch by it", bound=0.0, found=torch, at_least=False, unit="")
    yield Goal(what="4096 tables, 60 s motions", bound=2.0, found=memory, at_least=False, unit="GiB")
