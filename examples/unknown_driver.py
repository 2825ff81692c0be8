"""An unknown driver with an HMI that infers the driver, and how much that gains.

Several trips of one driver with each of three HMIs: one made for the average driver, one that
infers the driver, and one that knows the driver. Attention is hidden.

Run: python examples/unknown_driver.py --driver bart --trips 3
"""

import argparse

import numpy as np

from hmi_marl import TeamConfig, make_driver_policy, make_hmi
from hmi_marl.envs.drivers import Traits, get_driver
from hmi_marl.experiments.adaptation.trips import play_trips

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument("--driver", default="bart", help="lisa, homer, ... (default: %(default)s)")
parser.add_argument(
    "--trips", type=int, default=3, help="one after the other (default: %(default)s)"
)
parser.add_argument("--drives", type=int, default=50, help="repetitions (default: %(default)s)")
parser.add_argument(
    "--policy", default="trained:driver", help="of the driver (default: %(default)s)"
)
parser.add_argument(
    "--adaptive",
    default="adapt",
    help="or adapt:choosing, adapt:expected:bayes (default: %(default)s)",
)
options = parser.parse_args()

driver = get_driver(options.driver)
config = TeamConfig(driver=driver, ai_sees_attention=False)
traits = Traits.of([driver] * options.drives)
seeds = np.arange(options.drives * options.trips, dtype=np.uint64).reshape(options.drives, -1)
earned: list[float] = []
for name in ("belief:average", options.adaptive, f"belief:{options.driver}"):
    hmi, policy = make_hmi(name, config), make_driver_policy(options.policy, config)
    trips = play_trips(config, policy, hmi, traits, seeds, keep_beliefs=True)
    earned.append(trips.returns[:, -1].mean())
    print(f"{name:<16} attention return of each trip: {trips.returns.mean(axis=0).round(1)}")
    if trips.probabilities is not None:
        named = hmi.estimator.belief.named()
        shown = ", ".join(f"{name} {p.mean():.2f}" for name, p in named.items())
        print(f"{'':<16} belief at the end: {shown}")

average, adaptive, knowing = earned
gain = knowing - average
print(f"in the last trip, knowing {options.driver} gains {gain:.0f}", end="")
print(f"; {options.adaptive} reaches {(adaptive - average) / gain:.0%} of it" if gain > 1 else "")
