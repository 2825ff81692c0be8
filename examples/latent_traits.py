"""Latent traits from driving alone: collect, learn, and print where drivers lie in latent space.

Run: python examples/latent_traits.py   (or with a trained driver: --driver runs/homer)
"""

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.demonstrations.dataset import held_out
from hmi_marl.demonstrations.parquet import read_observed, write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.training.traits.run import learn_traits
from hmi_marl.training.traits.settings import TraitSettings

parser = argparse.ArgumentParser(
    description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
)
parser.add_argument(
    "--driver", default="rule", help="trained:driver, a trained run's folder, or rule (default)"
)
parser.add_argument(
    "--windows", type=int, default=100, help="of 20 s, for each driver (default: %(default)s)"
)
parser.add_argument(
    "--updates", type=int, default=60, help="before the policy drives (default: %(default)s)"
)
parser.add_argument(
    "--steps", type=int, default=50_000, help="that the policy drives (default: %(default)s)"
)
parser.add_argument("--out", type=Path, default=Path("runs/latent-traits"), help="folder")
choices = parser.parse_args()

# What could be observed of four drivers, in a file separate from the hidden truth.
data = choices.out / "demonstrations"
record = CollectSettings(driver_policy=choices.driver, steps=100 * choices.windows)
with tqdm(total=record.total_steps, unit=" steps", desc="driving") as bar:
    write_demonstrations(data, collect(record, bar.update))

# A fifth of the windows is labelled by driver; the rest is driving alone.
settings = TraitSettings(
    supervision="id",
    average_updates=5 * choices.updates,
    imitation_updates=choices.updates,
    steps=choices.steps,
    num_teams=16,
)
learn_traits(settings, data, choices.out / "traits")

# Every driver's held-out windows, pooled: the posterior of z.
model = load_traits(choices.out / "traits")
observed = read_observed(data)
unseen = observed.take(held_out(observed.driver, settings.held_out_share))
sums = model.encoder.encode(unseen.states, unseen.actions, unseen.alerts, unseen.length)
print("the drivers in latent space, mean and standard deviation of z from unseen windows:")
for who, name in enumerate(unseen.names):
    latent = model.encoder.latent(sums[unseen.driver == who].sum(axis=0, keepdims=True))
    mean, spread = latent.mean[0], np.sqrt(latent.variance[0])
    print(f"{name:<6} z = {np.round(mean, 2).tolist()} ± {np.round(spread, 2).tolist()}")
