"""A specimen of one's own: three unequal storeys, the top one soft, and what it costs not to know it.

python examples/custom_specimen.py
python examples/custom_specimen.py --earthquakes 2    # fewer; each is 20 s long
"""

import argparse

import numpy as np

from baselines.lqr import LinearFeedback, sampled_lqr
from shake_env import Specimen, make_scenario
from shake_env.rollout import noise_earthquakes, rollout

parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
parser.add_argument("--earthquakes", type=int, default=8, help="filtered-noise motions to try")
earthquakes = parser.parse_args().earthquakes

masses = np.array([45.0, 40.0, 25.0])  # [kg], first floor first
stiffnesses = np.array([120e3, 90e3, 30e3])  # [N/m], storey below each floor
dampings = 2.0 * 0.03 * np.sqrt(masses * stiffnesses)  # [N s/m], 3 % of each storey by itself
specimen = Specimen(masses=tuple(masses), stiffnesses=tuple(stiffnesses), dampings=tuple(dampings))
scenario = make_scenario("linear", {"specimen": specimen})
print("fixed-base frequencies [Hz]", np.round(specimen.fixed_base_frequencies, 2))
print("on the table, with the oil column [Hz]", np.round(scenario.plant.natural_frequencies, 2))

# The law that knows the specimen, and one made for equal storeys of the same mass.
guess = make_scenario("linear", {"stories": 3, "mass_ratio": specimen.mass / 180.0})
laws = {
    "knows the specimen": sampled_lqr(scenario.discrete, scenario.stage_cost),
    "guesses equal storeys": sampled_lqr(guess.discrete, guess.stage_cost),
}
expected = laws["knows the specimen"].performance.base_shear_rms_ratio
print(f"expected base-shear error {100 * expected:.1f} %")
quakes = noise_earthquakes(scenario, earthquakes, seed=2_000_000)
for name, law in laws.items():
    rows, _ = rollout(LinearFeedback(scenario, law.gain), scenario, quakes)
    shear = np.mean([row.base_shear_rms_error for row in rows])
    cost = np.mean([row.cost for row in rows])
    print(f"{name:22s} cost {cost:.3f}, base-shear error {100 * shear:.1f} %")
