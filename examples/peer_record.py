"""A PEER record: read, scaled to a table, repeated by a laboratory's controllers.

python examples/peer_record.py my_record.AT2
python examples/peer_record.py                 # writes a PEER file from an embedded record first
python examples/peer_record.py --seconds 10    # only the first seconds
"""

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from baselines.registry import make_baseline
from shake_env import Record, RecordedMotion, load_record, make_scenario, read_motion
from shake_env.model.parameters import GRAVITY
from shake_env.motion import TableCapacity, fit_amplitude
from shake_env.rollout import Earthquake, rollout


def write_at2(record: Record, path: Path) -> None:
    """Write a record as PEER's database does: four lines of header, five values of g a line."""
    values = record.acceleration / GRAVITY
    rows = [values[i : i + 5] for i in range(0, len(values), 5)]
    header = [
        "PEER NGA STRONG MOTION DATABASE RECORD",
        record.name,
        "ACCELERATION TIME SERIES IN UNITS OF G",
        f"NPTS= {len(values)}, DT= {record.sampling_interval:.5f} SEC",
    ]
    body = ["".join(f"{value:15.7E}" for value in row) for row in rows]
    path.write_text("\n".join([*header, *body]) + "\n", encoding="ascii")


parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("file", type=Path, nargs="?", help="an .AT2 file")
parser.add_argument("--seconds", type=float, help="only the first seconds of the motion")
arguments = parser.parse_args()

with tempfile.TemporaryDirectory() as folder:
    file = arguments.file
    if file is None:
        file = Path(folder) / "NAPA2014_68150_HNE.AT2"
        write_at2(load_record("napa2014_68150_hne"), file)
    (record,) = read_motion(file)
if arguments.seconds:
    samples = round(arguments.seconds / record.sampling_interval)
    record = replace(record, acceleration=record.acceleration[:samples])
peak = np.max(np.abs(record.acceleration))
print(f"{record.name}: {record.duration:.1f} s, peak {peak / GRAVITY:.3f} g")

scenario = make_scenario("laboratory")
motion = RecordedMotion(record=record, highpass_frequency=0.2, lowpass_frequency=25.0)
fit = fit_amplitude(motion, TableCapacity.from_actuator(scenario.actuator, scenario.specimen))
print(f"amplitude x {fit.factor:.3f}, governed by {fit.governed_by}")
for name in ("lqg-dac", "tvc"):
    rows, _ = rollout(make_baseline(name, scenario), scenario, [Earthquake(record.name, fit.motion)])
    row = rows[0]
    print(
        f"{name:18s} acceleration error {100 * row.acceleration_rms_error:5.1f} %, "
        f"base-shear error {100 * row.base_shear_rms_error:5.1f} %, "
        f"stroke {1e3 * row.peak_displacement:.0f} mm"
    )
