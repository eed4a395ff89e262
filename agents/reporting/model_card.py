"""The card beside a policy: made from its file's header and from results of the protocol."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from agents.policies.policy_file import PolicyFile, file_digest, load_policy
from agents.reporting.evaluation_tables import interval_text
from agents.reporting.figures.training_curve import draw_training_curve
from agents.reporting.markdown_blocks import markdown_table
from agents.reporting.robustness_tables import read_robustness, robustness_findings
from agents.run_directory import read_json
from agents.scenario_options import given_options
from shake_env.errors import ParameterError
from shake_env.files import write_text

ROWS = (
    ("relative_cost", "cost / {normaliser}", 3, 1.0),
    ("interquartile_mean", "interquartile mean of that", 3, 1.0),
    ("worst_twentieth", "worst 5 % of that", 3, 1.0),
    ("reference_cost", "cost / {reference}", 3, 1.0),
    ("probability_of_improvement", "probability of costing less than {reference}", 2, 1.0),
    ("optimality", "cost / J*", 3, 1.0),
    ("regret_closed", "regret closed [%]", 1, 100.0),
    ("base_shear_rms_error", "base-shear error, rms [%]", 2, 100.0),
    ("acceleration_rms_error", "acceleration error, rms [%]", 1, 100.0),
    ("drift_error", "peak drift off by, median [%]", 1, 100.0),
    ("energy_error", "energy off by, median [%]", 1, 100.0),
)


def write_card(
    file: str | PathLike[str],
    results: Sequence[Path] = (),
    limits: str = "",
    robustness: Path | None = None,
) -> list[Path]:
    """Write the card of a policy file beside it, and return the files written.

    Parameters
    ----------
    file
        Policy file.
    results
        Result files of the protocol. Each has to hold a row that was made of this file, among others
        or alone.
    limits
        Further sentences on limits of use.
    robustness
        Result of ``shake robustness`` that holds this policy; None: none was made.

    Raises
    ------
    ParameterError
        If a result has no row of this policy.
    PolicyFileError
        If the policy cannot be read.
    """
    file = Path(file)
    policy, sha = load_policy(file), file_digest(file)
    evaluations = [(result, _row(result, path, sha)) for path, result in _read(results)]
    findings = [] if robustness is None else robustness_of(robustness, sha)
    if robustness is not None and not findings:
        raise ParameterError(
            "robustness", str(robustness), "does not hold this policy: run shake robustness on it"
        )
    written = [file.with_suffix(".md")]
    figure = None
    if len(policy.card.get("curve", ())) > 1:
        figure = file.with_suffix(".png")
        draw_training_curve(policy.card["curve"], figure)
        written.append(figure)
    text = card_text(policy, file, sha, evaluations, figure, limits, findings)
    write_text(written[0], text)
    return written


def robustness_of(file: str | PathLike[str], sha: str) -> list[str]:
    """Return what a robustness result says of the policy with this SHA-256, for its model card."""
    file = Path(file)
    result = read_robustness(file)
    for each in result["controllers"]:
        if each["source"] is not None and each["source"]["sha256"] == sha:
            return robustness_findings(result, each["name"])
    return []


def _read(results: Sequence[Path]) -> list[tuple[Path, dict[str, Any]]]:
    return [(path, read_json(path, ParameterError, "result")) for path in results]


def _row(result: dict[str, Any], path: Path, sha: str) -> dict[str, Any]:
    for row in result.get("rows", ()):
        if any(source["sha256"] == sha for source in row["sources"]):
            chosen: dict[str, Any] = row
            return chosen
    raise ParameterError("result", str(path), "holds no row of this policy: run shake evaluate on it")


def card_text(
    policy: PolicyFile,
    file: str | PathLike[str],
    sha: str,
    evaluations: Sequence[tuple[dict[str, Any], dict[str, Any]]],
    figure: Path | None,
    limits: str,
    findings: Sequence[str] = (),
) -> str:
    """Return the model card of a policy as Markdown.

    Parameters
    ----------
    policy, file, sha
        The policy, where it lies and its SHA-256.
    evaluations
        Results, and their row of this policy.
    figure
        Its learning curve, or None.
    limits
        Further sentences on limits of use.
    findings
        Sentences on tables and motions that it was not trained on.
    """
    file = Path(file)
    card = policy.card
    config = card.get("config", {})
    scenario = given_options(config.get("scenario", {}))
    name = scenario.pop("scenario", "unknown")
    changed = ", ".join(f"{key} = {value}" for key, value in scenario.items())
    memory = "none" if policy.memory is None else policy.memory.summary
    widths = "x".join(str(len(bias)) for bias in policy.biases[:-1])
    twice = ", one and its mirror image" if config.get("odd_symmetry") else ""
    first = card.get("first")  # the policy that training began with
    facts = [
        ("scenario", f"{name}{f' with {changed}' if changed else ''}"),
        ("algorithm", config.get("algorithm", "unknown")),
        ("made by", f"`{card.get('command', 'unknown')}`"),
        *([("began with", f"`{first['sha256']}`, made by `{first['command']}`")] if first else []),
        ("seed", str(config.get("seed", "unknown"))),
        ("code", f"version {card.get('version', 'unknown')} ({card.get('code') or 'unknown'})"),
        ("observation", f"{policy.observation_size} numbers at {card.get('control_rate', 0.0):g} Hz"),
        ("network", f"{widths} {policy.activation}{twice}, memory: {memory}"),
        ("base law", f"{config_base(config)}, corrected by {policy.authority:g} of the limit"),
        ("SHA-256", f"`{sha}`"),
    ]
    lines = [f"# {file.stem}", "", markdown_table(("", ""), facts)]
    trained = card.get("evaluation", {})
    if trained:
        lines += [
            f"Training took {trained['steps']:,} control periods, {trained['seconds'] / 60.0:.1f} "
            "minutes in the last process. Its best evaluation, whose policy this is, came after "
            f"{trained['best_steps']:,}: {trained['cost_ratio']:.4f} of the reference's cost on the "
            "evaluation earthquakes of training.",
            "",
        ]
    if figure is not None:
        lines += [f"![Learning curve]({figure.name})", ""]
    for result, row in evaluations:
        lines += _evaluation(result, row, sha)
    if not evaluations:
        lines += ["Not evaluated on test earthquakes yet.", ""]
    if findings:
        lines += [
            "## Where it was not trained",
            "",
            f"One thing changed at a time, everything else as on `{name}`, and pairs "
            "(`shake robustness`, docs/robustness.md).",
            "",
            *(f"- {sentence}" for sentence in findings),
            "",
        ]
    lines += ["## Limits of use", "", *_limits(policy, name, evaluations, limits), ""]
    return "\n".join(lines)


def config_base(config: dict[str, Any]) -> str:
    """Return the base law that a configuration's policy corrects."""
    options = config.get(str(config.get("algorithm", "")).replace("-", "_"), {})
    return str(options.get("base_controller", "unknown"))


def _evaluation(result: dict[str, Any], row: dict[str, Any], sha: str) -> list[str]:
    where = result.get("evaluation_task", result["scenario"])
    lines = [
        f"## Evaluation on {where}",
        "",
        f"{len(result['earthquakes'])} test earthquakes, code {row['code']}; 95 % intervals.",
        "",
    ]
    if row["runs"] > 1:
        place = [source["sha256"] for source in row["sources"]].index(sha)
        lines += [
            f"The figures are of all {row['runs']} seeds of the experiment; this one's cost relative to "
            f"{result['normaliser']} is {row['run_costs'][place]:.4f}.",
            "",
        ]
    same = result["reference"] == result["normaliser"]
    figures = [
        (title.format(**result), interval_text(row[key], digits, scale))
        for key, title, digits, scale in ROWS
        if row[key] is not None and not (same and key == "reference_cost")
    ]
    figures.append(("episodes that a limit ended", f"{row['failures']} of {row['episodes']}"))
    figures.append(("one decision", f"{1e6 * row['decision_time']:.0f} us"))
    return [*lines, markdown_table(("figure", "value"), figures)]


def _limits(
    policy: PolicyFile,
    name: str,
    evaluations: Sequence[tuple[dict[str, Any], dict[str, Any]]],
    limits: str,
) -> list[str]:
    rate = policy.card.get("control_rate", 0.0)
    lines = [
        f"- For `{name}` as trained: {policy.observation_size} observations in that order and scale, at "
        f"{rate:g} Hz. Another observation or rate is refused; another plant is not noticed.",
    ]
    homogeneous = policy.memory is None and policy.activation == "relu" and policy.output == "clip"
    if homogeneous and not any(bias.any() for bias in policy.biases):
        lines.append(
            "- The actor has no biases: half the motion gets half the current, within the feature clip."
        )
    else:
        lines.append("- Amplitudes other than those of training were not learned.")
    for result, row in evaluations:
        if row["failures"]:
            where = result.get("evaluation_task", result["scenario"])
            lines.append(f"- On {where} a limit ended {row['failures']} of {row['episodes']} episodes.")
    if limits:
        lines.append(f"- {limits}")
    return lines
