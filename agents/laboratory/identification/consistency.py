"""Whether a log can be of a test: its motion is the scenario's, its channels are what they say."""

from __future__ import annotations

import numpy as np

from agents.laboratory.identification.fit import Fit
from agents.laboratory.identification.plausibility import LOUD, unit_mistake
from agents.laboratory.identification.prediction import predict_response
from agents.laboratory.logs.test_log import CURRENT, TARGET, TestLog, unit_of
from shake_env.errors import LogError
from shake_env.model.parameters import FloatArray
from shake_env.motion.targets import MotionSet, RecordedMotion, control_steps, target_history
from shake_env.scenario.scenario import Scenario

CLOSE = 1e-3  # of the motion's rms: the most by which a target may differ from it
EXPLAINED = 0.5  # share of a channel's power above its noise that the fitted model must explain
WHOLE = 0.98  # share of a motion's periods that a log of all of it holds at least
ALIKE = 0.9  # correlation at which a channel is taken for another one


def require_motion(log: TestLog, scenario: Scenario) -> None:
    """Raise LogError unless a log's target is the recorded motion of a scenario, from its start.

    A log that was ended early by a limit holds the first part of it. Of filtered noise nothing is known
    but its target, which the log itself holds.
    """
    motion = scenario.motion
    if not isinstance(motion, RecordedMotion):
        return
    history = target_history(motion, scenario.physics_step).acceleration
    wanted = history[scenario.substeps :: scenario.substeps]
    target = log.channels[TARGET]
    if len(target) > len(wanted) + 1:
        remedy = f"the motion {motion.source.name} has {len(wanted)} control periods"
        raise LogError(f"{log.name}, samples", log.samples, remedy)
    wanted = np.pad(wanted, (0, max(0, len(target) - len(wanted))))[: len(target)]
    power, size = float(np.mean(wanted**2)), float(np.mean(target**2))
    error = float(np.mean((target - wanted) ** 2))
    if error <= CLOSE**2 * max(power, 1e-300):
        return
    alike = float(np.mean(target * wanted) / np.sqrt(max(power * size, 1e-300)))
    if abs(alike) > 0.999:
        ratio = float(np.copysign(np.sqrt(size / power), alike))
        likely = unit_mistake(unit_of(TARGET), ratio)
        why = f"is this motion at {ratio:.4g} times its amplitude" + (f": {likely}" if likely else "")
    else:
        why = f"is another motion (correlation {alike:.3f})"
    raise LogError(
        f"{log.name}, {TARGET}", why, f"the log must hold {motion.source.name} as the scenario has it"
    )


def part_covered(log: TestLog, scenario: Scenario) -> tuple[float, float] | None:
    """Return the seconds that a log holds of its motion, and those of the motion; None: all of them.

    A test that was stopped is a log as any other; what is said of the whole motion does not hold for it.
    """
    motion = scenario.motion
    if isinstance(motion, MotionSet):
        return None
    periods = control_steps(motion, scenario.control_period, scenario.physics_step)
    if log.samples >= WHOLE * periods:
        return None
    return log.duration, periods * scenario.control_period


def require_explained(fit: Fit) -> None:
    """Raise LogError where the fitted model does not explain a channel, and say which it looks like.

    Nothing is asked of a channel that is near its sensor's noise in the log and in the model. One that
    is quiet in the log only must explain what the model predicts.
    """
    for each, errors in zip(fit.likelihood.data, fit.likelihood.errors(fit.mode[None]), strict=True):
        noise = each.variance * len(each.coefficients)
        power, left = np.sum(each.coefficients**2, axis=0), np.sum(errors[0] ** 2, axis=0)
        predicted = np.sum((each.coefficients - errors[0]) ** 2, axis=0)
        heard = power > LOUD * noise
        # Of what stands above the sensor's noise, where enough does.
        above = np.maximum(np.where(heard, power - noise, predicted), 1e-300)
        lost = np.maximum(left - noise, 0.0)
        shares = dict(zip(each.channels, (1.0 - lost / above).tolist(), strict=True))
        loud = dict(zip(each.channels, (heard | (predicted > LOUD * noise)).tolist(), strict=True))
        poor = [name for name, share in shares.items() if loud[name] and share < EXPLAINED]
        if not poor:
            continue
        # The prior's table: a fit to channels that are not what they say leads anywhere.
        model = fit.likelihood.scenario
        readings = predict_response([model], each.log.channels[CURRENT], each.channels).readings[0]
        words = []
        for name in poor:
            measured = each.log.channels[name]
            like = [abs(_correlation(measured, readings[:, c])) for c in range(len(each.channels))]
            best = each.channels[int(np.argmax(like))]
            if best != name and max(like) > max(ALIKE, like[each.channels.index(name)] + 0.1):
                words.append(f"{name} looks like {best} (correlation {max(like):.2f})")
            else:
                share = 100.0 * max(shares[name], 0.0)
                size = np.std(measured) / max(np.std(readings[:, each.channels.index(name)]), 1e-300)
                words.append(
                    f"of {name} the model explains {share:.0f} % of the power "
                    f"(the log's rms is {size:.3g} times the model's)"
                )
        remedy = (
            "the log is of another table, or its channels are shuffled or scaled wrongly: "
            "check them, or leave them out by --without"
        )
        raise LogError(each.log.name, "; ".join(words), remedy)


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float(a @ b) / size if size > 0.0 else 0.0
