"""What is evaluated: scenarios, how often, and the controllers beside the policies."""

from __future__ import annotations

from dataclasses import dataclass, replace

from agents.scenario_options import ScenarioOptions


@dataclass(frozen=True, kw_only=True)
class EvaluationTask:
    """Something to be tested on: a scenario, how often, and the controllers beside the policies."""

    name: str
    options: ScenarioOptions
    baselines: tuple[str, ...]  # controllers with the same information, beside the reference
    earthquakes: int = 200
    fidelity: bool = True  # whether response spectrum, drift and energy are compared: most of the time
    trained_on: str | None = None  # task whose policies it takes; None: its own


# The nonlinear plan is the strongest classical controller: learned policies are compared with it, too.
LABORATORY_BASELINES = (
    "lqg", "lqg-dac", "lqr-friction-ff", "h-infinity", "inverse-ff-tvc", "lqg-searched",
    "lqg-searched-force", "tvc", "nmpc", "planned", "none",
)  # fmt: skip
FRICTION = ScenarioOptions(set=("nonlinearity.friction.coulomb=300",))
# A step of the physics as long as a control period does not resolve how friction turns about. LQR then
# loses a third instead of a sixth, and there is more to learn: a warning, and what coarse plants report.
COARSE_FRICTION = replace(FRICTION, set=(*FRICTION.set, "physics_step=0.005"))

# fmt: off
EVALUATION_TASKS: tuple[EvaluationTask, ...] = (
    EvaluationTask(name="linear", options=ScenarioOptions(), baselines=("none",)),
    EvaluationTask(name="as-printed", options=ScenarioOptions("as-printed"), baselines=("none",)),
    # The reference there is LQR, which does not know of the friction.
    EvaluationTask(name="friction", options=FRICTION, baselines=("lqr-friction-ff", "nmpc", "none")),
    EvaluationTask(
        name="friction-coarse",
        options=COARSE_FRICTION,
        baselines=("lqr-friction-ff", "none"),
        earthquakes=50,  # the bound of each takes five seconds
    ),
    EvaluationTask(
        name="laboratory", options=ScenarioOptions("laboratory"), baselines=LABORATORY_BASELINES
    ),
    EvaluationTask(
        name="records",
        options=ScenarioOptions("records"),
        baselines=LABORATORY_BASELINES,
        trained_on="laboratory",
    ),
    EvaluationTask(
        name="unknown-specimen",
        options=ScenarioOptions("unknown-specimen"),
        baselines=(
            "lqg", "lqg-dac", "adaptive", "multi-model", "h-infinity", "lqg-searched", "nmpc",
            "nmpc-adaptive", "none",
        ),
        fidelity=False,
    ),
    EvaluationTask(
        name="yielding",
        options=ScenarioOptions("yielding"),
        baselines=(
            "preview-lqr", "h-infinity", "lqg-searched", "lqg-searched-force", "nmpc", "planned", "none",
        ),
    ),
    EvaluationTask(
        name="field",
        options=ScenarioOptions("field"),
        baselines=(
            "lqg", "lqg-dac", "lqr-friction-ff", "lqg-searched", "nmpc", "nmpc-adaptive", "none",
        ),
        earthquakes=50,  # `nmpc-adaptive` takes ten seconds of each
        fidelity=False,
    ),
)
# fmt: on
