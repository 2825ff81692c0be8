"""A custom training protocol: the HMI learns first, then the driver learns with that HMI.

A protocol is a frozen dataclass that lays out phases: which seat learns for how many steps, with
which partner and for which reward. Needs the train extra: pip install 'hmi-marl[train]'

Run: python examples/new_protocol.py --steps 200000 --out runs/hmi-first
"""

import argparse
import json
from dataclasses import dataclass
from pathlib import Path

from hmi_marl.cli import main
from hmi_marl.envs.config import DRIVER, VEHICLE_AI
from hmi_marl.training.protocols.registry import register
from hmi_marl.training.protocols.settings import LEARNED, Phase, TrainSettings


@dataclass(frozen=True)
class HmiFirst(TrainSettings):
    """HMI first: the HMI learns with a rule-based driver, then the driver with the learned HMI.

    Example: hmi-marl train hmi-first --out runs/hmi-first
    """

    hmi_steps: int = 1_000_000
    """Environment steps in which the HMI learns."""
    driver_steps: int = 4_000_000
    """Environment steps in which the driver learns."""

    def phases(self):
        """Return the two phases, in their order."""
        alerting = self.team(self.drivers, "attention")  # the teams, with the reward to learn from
        driving = self.team(self.drivers, "driving")
        return (
            Phase(
                "hmi",
                VEHICLE_AI,
                alerting,
                self.hmi_steps,
                partner="rule",  # any name of a driver policy
                cards=(self.card(VEHICLE_AI, alerting),),
            ),
            Phase(
                "driver",
                DRIVER,
                driving,
                self.driver_steps,
                partner=LEARNED,  # the HMI as it was learned above
                cards=(self.card(DRIVER, driving),),
            ),
        )

    @classmethod
    def for_comparison(cls, budget, **shared):
        """Return the settings by which ``hmi-marl compare`` gives it as many steps as others."""
        return cls(hmi_steps=budget.hmi_steps, driver_steps=budget.driver_steps, **shared)


# The registry line: train, compare and their --help now know the protocol.
register("hmi-first", HmiFirst)

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--steps", type=int, default=200_000, help="of each phase (default: %(default)s)"
    )
    parser.add_argument("--teams", type=int, default=128, help="at a time (default: %(default)s)")
    parser.add_argument("--duration", type=float, default=10.0, help="[s] (default: %(default)s)")
    parser.add_argument(
        "--out", type=Path, default=Path("runs/hmi-first"), help="folder (default: %(default)s)"
    )
    args = parser.parse_args()

    # Settings that all protocols share, such as --num-teams, come from TrainSettings.
    settings = f"--hmi-steps {args.steps} --driver-steps {args.steps} --num-teams {args.teams}"
    command = f"train --out {args.out} hmi-first {settings} --duration {args.duration:g}"
    if main(command.split()) == 0:
        batches = json.loads((args.out / "curve.json").read_text("utf-8"))
        for phase in ("hmi", "driver"):
            returns = [row["return"] for row in batches if row["phase"] == phase]
            print(f"{phase}: return {returns[0]:.1f} in the first batch, {returns[-1]:.1f} at last")
