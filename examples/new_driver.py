"""A custom driver and a population: how much the best HMI gains.

Run: python examples/new_driver.py --beta 0.4 --alpha 0.3 --eta 0.5
"""

import argparse

import numpy as np

from hmi_marl import Driver, TraitDistributions, Uniform, merge_v0, oracle

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--beta",
    type=float,
    default=0.4,
    help="β, to be distracted (default: %(default)s)",
)
parser.add_argument("--alpha", type=float, default=0.3, help="α, to recover (default: %(default)s)")
parser.add_argument("--eta", type=float, default=0.5, help="η of alerts (default: %(default)s)")
args = parser.parse_args()

mona = Driver("mona", args.beta, args.alpha, args.eta, inflation=2.0)
without = oracle.evaluate(0.0, mona).distraction_return
best = oracle.solve_alerts(mona)
print(f"{mona.name} ({mona})")
print(f"  distraction return without an HMI {without:8.2f}")
print(f"  with the optimal one              {best.distraction_return:8.2f}")
print(f"  alerts in an episode              {best.alerts:8.2f}")

# Drivers who react to alerts, with any other traits; a new one is drawn at each reset.
receptive = TraitDistributions(eta=Uniform(0.5, 1.0))
env = merge_v0.parallel_env(driver=receptive, duration=2.0)
etas = []
for seed in range(5):
    _, infos = env.reset(seed=seed)
    etas.append(infos["driver"]["eta"])
print(f"five drawn drivers have η = {np.round(etas, 2).tolist()}")
