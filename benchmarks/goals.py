"""What the project set out to reach, beside what was measured, and why a goal that is missed is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from benchmarks.arithmetic import CONTROLLED, FULL


@dataclass(frozen=True, kw_only=True)
class Goal:
    """One goal and the measured value."""

    what: str
    bound: float
    value: float
    at_least: bool = True
    unit: str = "times"
    why: str = ""  # said where it is missed

    @property
    def met(self) -> bool:
        """Whether the goal is reached."""
        return self.value >= self.bound if self.at_least else self.value <= self.bound

    def row(self) -> str:
        """Return the row of a Markdown table."""
        word = "at least" if self.at_least else "at most"
        ratio = f"{self.value / self.bound:.2f}" if self.bound else "-"
        verdict = "yes" if self.met else "**no**"
        return (
            f"| {self.what} | {word} {number(self.bound)} {self.unit} | {number(self.value)} | {ratio} "
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
    "A linear step of one table takes 2.7 us, of which a compiled call takes half; the rest are "
    "Gymnasium's wrappers, the check of the action, and `info`."
)
VECTOR = (
    "A table takes 96 ns at 256 tables and at 1024: random numbers a fifth, the products a third; cost, "
    "limits, and turning rows of quantities into rows of tables the rest. Vectorised CartPole, four "
    "float32 states in a dozen calls of numpy, falls from 1300 ns a table at 64 to 120 at 1024, where "
    "its calls cost nothing any more."
)
THREADS = (
    "Two threads take pieces of the blocks one by one, and the second is woken for each period. Where "
    "other work has the cores, it comes late or is interrupted in its piece, for which the first waits. "
    "How long it takes to wake on an idle machine was not examined."
)
DUMMY = (
    "A table in a batch of 64 takes 0.25 us as SB3 asks for it, of which 0.2 are the compiled step; "
    "what remains are 64 dictionaries, a copy of the observations and three operations on rewards."
)
TEXTBOOK = (
    "Blocks of nine take 98 multiply-adds a sample, 20 ms at the machine's peak, which products of 40 "
    "rows reach; the squares take 5 more and the inputs' way into the products 3. A tenth of the "
    "textbook's time is about what that makes: 30."
)
PPO_ROLLOUT = (
    "A roll-out's other work is a pass of two networks and SB3's bookkeeping, some hundred operations "
    "of torch and numpy: 450 us a period on linear, 680 on laboratory. 6 % of the whole leave 29 us, "
    "15 % leave 120. Between two passes of the networks what steps the tables has left the caches and "
    "takes twice its time: linear: the compiled period 9 us of 50; laboratory: the period 30 of 250, "
    "estimators and laws 65, and episodes that begin 70 (the stream of one alone takes 70 us, and 0.4 "
    "begin a period). The rest are calls of numpy, SB3's 64 dictionaries, and the arrays handed out."
)
RESET = (
    "A table with a specimen of its own needs its matrices over a control period: three matrix "
    "exponentials, two stationary covariances and a factor of the noise, assembled and computed in one "
    "compiled call, a third of a reset. The rest is Python: checks of the drawn numbers, copies into "
    "records, the episode's stream, and the environment around it."
)


def goals(results: dict[str, Any]) -> list[Goal]:
    """Return the goals of every group that was measured."""
    groups = {
        "single": _single, "vector": _vector, "threads": _threads, "resets": _resets,
        "peers": _peers, "arithmetic": _arithmetic, "closed loops": _closed_loops,
        "learning": _learning, "decision": _decision, "footprint": _footprint,
    }  # fmt: skip
    return [goal for name, group in groups.items() if name in results for goal in group(results[name])]


def _single(rates: dict[str, float]) -> Iterator[Goal]:
    cart = rates["CartPole-v1"]
    linear, laboratory = rates["linear, n_m = 5"] / cart, rates["laboratory"] / cart
    tall = rates["linear, n_m = 2"] / rates["linear, n_m = 10"]
    yield Goal(what="one linear table beside CartPole-v1", bound=3.0, value=linear, why=SINGLE)
    yield Goal(what="cost of 10 storeys beside 2", bound=1.2, value=tall, at_least=False)
    yield Goal(what="one laboratory beside CartPole-v1", bound=2.0, value=laboratory, why=SINGLE)


def _vector(results: dict[str, dict[str, float]]) -> Iterator[Goal]:
    bounds = {"64 tables": 4.5, "256 tables": 4.0, "1024 tables": 1.5}
    for tables, rates in results.items():
        ratio = rates["linear"] / rates["CartPole-v1"]
        what = f"{tables}, linear, beside vectorised CartPole"
        yield Goal(what=what, bound=bounds[tables], value=ratio, why=VECTOR)
    sb3 = results["64 tables"]
    ratio = sb3["linear, SB3 VecEnv"] / sb3["CartPole-v1, SB3 DummyVecEnv"]
    yield Goal(
        what="64 tables for SB3 beside DummyVecEnv of CartPole", bound=50.0, value=ratio, why=DUMMY
    )
    wide = results["1024 tables"]
    each = wide["laboratory"] / wide["laboratory, a specimen each"]
    yield Goal(what="cost of a specimen each", bound=2.0, value=each, at_least=False)


def _threads(results: dict[str, dict[str, float]]) -> Iterator[Goal]:
    bounds = {"1024 tables": 2.5, "4096 tables": 1.5}
    for tables, rates in results.items():
        ratio = rates["linear, two threads"] / rates["CartPole-v1"]
        what = f"{tables}, linear, two threads, beside vectorised CartPole"
        yield Goal(what=what, bound=bounds[tables], value=ratio, why=THREADS)


def _resets(seconds: dict[str, float]) -> Iterator[Goal]:
    for name, bound in (("linear", 0.05), ("laboratory", 0.08), ("unknown-specimen", 0.3)):
        taken, why = 1e3 * seconds[name], RESET if name == "unknown-specimen" else ""
        what = f"a reset of {name}"
        yield Goal(what=what, bound=bound, value=taken, at_least=False, unit="ms", why=why)


def _peers(results: dict[str, Any]) -> Iterator[Goal]:
    bounds = {"256 tables": 3.0, "1024 tables": 2.0}
    for tables, rates in results.items():
        if tables == "unavailable":
            return
        ratio = rates["linear"] / rates["gymnax CartPole-v1, stepped"]
        what = f"{tables}, linear, beside gymnax CartPole under jit, stepped"
        yield Goal(what=what, bound=bounds[tables], value=ratio)


def _arithmetic(rates: dict[str, float]) -> Iterator[Goal]:
    peak = rates["matrix product 768 x 768"]
    for name in (CONTROLLED, FULL):
        what = f"1024 tables, {name}: peak of matrix products beside it"
        yield Goal(what=what, bound=2.5, value=peak / rates[name], at_least=False)
    whole = peak / rates["whole step, with its ground"]
    what = "1024 tables, whole linear step: peak of matrix products beside it"
    yield Goal(what=what, bound=3.5, value=whole, at_least=False)


def _closed_loops(results: dict[str, float]) -> Iterator[Goal]:
    for name, bound in (("textbook batch", 10.0), ("scipy dlsim", 300.0)):
        ratio = results[name] / results["blocks"]
        yield Goal(
            what=f"closed loops in blocks beside a {name}",
            bound=bound,
            value=ratio,
            why=TEXTBOOK if name == "textbook batch" else "",
        )
    apart = results["largest relative difference"]
    yield Goal(what="their largest difference", bound=1e-10, value=apart, at_least=False, unit="")


def _learning(results: dict[str, Any]) -> Iterator[Goal]:
    for name, bound in (("linear", 6.0), ("laboratory", 15.0)):
        rollout = 100.0 * results["PPO"][name]["share of roll-outs"]
        what = f"PPO, 64 tables, {name}: stepping, of roll-outs"
        yield Goal(what=what, bound=bound, value=rollout, at_least=False, unit="%", why=PPO_ROLLOUT)
    for name, ways in results["gradient"].items():
        grows = ways["gradient"]["exponent of memory"]
        if grows is not None:
            what = f"{name}: memory of a gradient grows as the window to the"
            # Linear; a fixed cost at the smallest windows, or pages of memory, tilt the fit a little.
            yield Goal(what=what, bound=1.1, value=grows, at_least=False, unit="")


def _decision(results: dict[str, dict[str, float]]) -> Iterator[Goal]:
    for name, times in results.items():
        ratio = times["SB3"] / times["numpy"]
        yield Goal(what=f"decision of {name}, beside SB3's predict", bound=1.0, value=ratio)


def _footprint(results: dict[str, Any]) -> Iterator[Goal]:
    taken, memory = results["import [s]"], results["4096 tables, 60 s motions [GiB]"]
    torch = float(results["torch imported"])
    yield Goal(what="import beyond what it needs", bound=0.5, value=taken, at_least=False, unit="s")
    yield Goal(what="imports of torch by it", bound=0.0, value=torch, at_least=False, unit="")
    yield Goal(what="4096 tables, 60 s motions", bound=2.0, value=memory, at_least=False, unit="GiB")
