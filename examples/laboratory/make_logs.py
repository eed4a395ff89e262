"""Make the logs of docs/howto/test_sequence.md: a hidden frame, shaken as the page's forecasts say.

Try:
  python examples/laboratory/make_logs.py
"""

import re
import tempfile
from dataclasses import replace
from pathlib import Path

from agents.laboratory.logs.log_file import write_log
from agents.laboratory.sequence.rehearsal import simulate_shake
from agents.laboratory.sequence.steps import close_shake, designed_on, next_shake, plan_sequence
from shake_env.scenario.scenario_file import parse_toml
from shake_env.scenario.uncertainty import Uncertainty

HERE = Path(__file__).parent
PAGE = HERE.parents[1] / "docs" / "howto" / "test_sequence.md"
TRUTH = {
    "specimen_mass": 97.0, "storey_stiffness_1": 9.6e4, "storey_stiffness_2": 8.4e4,
    "coulomb_friction": 190.0, "delay": 2.7, "bulk_modulus": 1.3e8,
}  # fmt: skip


def main() -> None:
    """Run the page's sequence on the hidden frame and write each log beside this file."""
    text = re.search(r'```toml title="frame.toml"\n(.*?)```', PAGE.read_text(), re.DOTALL)
    assert text is not None
    scenario = parse_toml("frame.toml", text[1])
    truth = replace(scenario, uncertainty=Uncertainty()).with_plant(TRUTH)
    with tempfile.TemporaryDirectory() as folder:
        sequence = plan_sequence(Path(folder) / "frame", scenario, amplitudes=(0.25, 1.0), samples=40)
        for number in (1, 2):
            sequence, _ = next_shake(sequence, override="a simulated frame")
            log, *_ = simulate_shake(
                designed_on(sequence), truth, sequence.next.controller or "lqg", number
            )
            log = replace(log, name=f"shake {number}")
            write_log(log, HERE / f"shake{number}.h5")
            sequence, _ = close_shake(sequence, log)
            print(f"shake {number}: {sequence.shakes[number - 1].inside}")


if __name__ == "__main__":
    main()
