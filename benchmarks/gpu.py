"""Measure the speed of training with the learner on a GPU, by the number of teams.

The training loop of ``hmi-marl train two-stage`` with its default settings, but for the number of
teams: the learner is on the device, and the world on many threads of the CPU. Each stage takes a
few batches, of which the first is left out, since it loads the compiled world and warms up the
device. Writes JSON beside what it prints, with the name of the card. Needs the train extra.

Run: python benchmarks/gpu.py --device cuda --num-teams 4096 8192 16384
"""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # spinning threads slow each other down

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from hmi_marl.files import write_json
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.two_stage import TwoStage
from hmi_marl.training.runs.folder import read_curve
from hmi_marl.workers import cores


def measure(device: str, teams: int, batches: int, threads: int | None) -> list[dict[str, Any]]:
    """Train for a few batches in each stage; return a row for each stage."""
    settings = TwoStage(num_teams=teams, device=device, threads=threads)
    steps = teams * settings.team(settings.drivers).horizon  # of a batch
    settings = replace(settings, driver_steps=batches * steps, hmi_steps=batches * steps)
    with tempfile.TemporaryDirectory() as folder:
        train(settings, Path(folder), quiet=True)
        curve = read_curve(Path(folder))
    rows = []
    for stage in ("driver", "hmi"):
        counted = [batch for batch in curve if batch["phase"] == stage][1:]
        seconds = [steps / batch["steps_per_second"] for batch in counted]
        learning = sum(
            spent * batch["share_of_time_learning"]
            for spent, batch in zip(seconds, counted, strict=True)
        )
        rows.append(
            {
                "device": device,
                "teams": teams,
                "stage": stage,
                "steps_per_s": steps * len(counted) / sum(seconds),
                "share_learning": learning / sum(seconds),
            }
        )
    return rows


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    whole = {"type": int, "metavar": "N"}
    parser.add_argument("--device", nargs="+", default=["cuda"], help="devices of the learner")
    parser.add_argument("--num-teams", **whole, nargs="+", default=[4096, 8192, 16384])
    parser.add_argument("--batches", **whole, default=4, help="batches of each stage")
    parser.add_argument("--threads", **whole, help="of the world; by default all cores with a GPU")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/gpu.json"))
    args = parser.parse_args()
    if args.batches < 2:
        parser.error("--batches is at least 2, since the first is left out")
    card = torch.cuda.get_device_name() if torch.cuda.is_available() else "no GPU"
    print(f"{card}, {cores()} cores of the CPU, torch {torch.__version__}", flush=True)
    rows = []
    for device in args.device:
        for teams in args.num_teams:
            for row in measure(device, teams, args.batches, args.threads):
                rows.append(row)
                print(
                    f"{device:>5} {teams:>6} teams, {row['stage']:<6} stage "
                    f"{row['steps_per_s']:>10,.0f} steps/s, learner {row['share_learning']:.0%}",
                    flush=True,
                )
    write_json(args.out, {"card": card, "cores": cores(), "torch": torch.__version__, "rows": rows})
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
