"""Measure what the checks for diverging learning cost, as a share of the learner's time.

One run of ``hmi-marl train two-stage`` in one process, with default settings but for its length.
Batches alternate, with the checks (losses, logits and weights finite) and without; the first pair,
in which everything is warmed up, is left out. Checks change no results, so both kinds learn alike.
Two numbers: the time within the checks as a share of the learner's, in the batches that have them;
and the ratio of the learner's times, with to without, as the median over pairs of batches, which
follow each other and so meet the same machine.

Writes JSON beside what it prints. Needs one extra: pip install 'hmi-marl[train]'

Run: python benchmarks/divergence.py --pairs 20
"""

import os

os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # spinning threads slow each other down

import argparse
import platform
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from hmi_marl.files import write_json
from hmi_marl.training.ppo import learner
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.two_stage import TwoStage

CHECKS: dict[str, object] = {"are_finite": True, "check_finite": None}
"""Checks that the learner calls, and what each returns where all is well."""


class Pairs:
    """Time the learner batch by batch, every other one without checks."""

    def __init__(self) -> None:
        self.learning: list[float] = []
        """Seconds of each batch's learning; those at even places have checks."""
        self.checking: list[float] = []
        """Seconds within the checks in each batch."""

    def learn(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """Return the learner's method, timed, and without checks in every other batch."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            self.checking.append(0.0)
            with ExitStack() as stack:
                for name, well in CHECKS.items():
                    check = getattr(learner, name)
                    instead = self._without(well) if len(self.learning) % 2 else self._timed(check)
                    stack.enter_context(patch.object(learner, name, instead))
                start = time.perf_counter()
                result = function(*args, **kwargs)
                self.learning.append(time.perf_counter() - start)
            return result

        return timed

    def _timed(self, check: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*args: Any) -> Any:
            start = time.perf_counter()
            result = check(*args)
            self.checking[-1] += time.perf_counter() - start
            return result

        return timed

    @staticmethod
    def _without(well: object) -> Callable[..., object]:
        return lambda *args: well


def measure(pairs: int, num_teams: int, seed: int) -> dict[str, Any]:
    """Train for so many pairs of batches and one more; return seconds and their ratios."""
    settings = TwoStage(num_teams=num_teams, seed=seed, hmi_steps=0, device="cpu")
    batch = num_teams * settings.team(settings.drivers).horizon
    settings = replace(settings, driver_steps=2 * (pairs + 1) * batch)
    watch = Pairs()
    timed = watch.learn(learner.PPOLearner.learn)
    with (
        tempfile.TemporaryDirectory() as folder,
        patch.object(learner.PPOLearner, "learn", timed),
    ):
        train(settings, Path(folder), quiet=True)
    checked, unchecked = (np.array(watch.learning[start::2]) for start in (2, 3))
    checks = np.array(watch.checking[2::2])
    return {
        "seconds_checked": checked.tolist(),
        "seconds_unchecked": unchecked.tolist(),
        "seconds_of_checks": checks.tolist(),
        "share_of_checks": float(checks.sum() / checked.sum()),
        "ratio": float(np.median(checked / unchecked)),
        "quartiles": np.quantile(checked / unchecked, (0.25, 0.75)).tolist(),
    }


def main() -> None:
    """Measure, print and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    whole = {"type": int, "metavar": "N"}
    parser.add_argument("--pairs", **whole, default=20, help="pairs of batches")
    parser.add_argument("--num-teams", **whole, default=TwoStage().num_teams, help="teams")
    parser.add_argument("--seed", **whole, default=0, help="random seed")
    parser.add_argument("--out", type=Path, default=Path("runs/bench/divergence.json"))
    args = parser.parse_args()
    found = measure(args.pairs, args.num_teams, args.seed)
    low, high = found["quartiles"]
    print(f"checks take {found['share_of_checks']:.3%} of the learner's time")
    print(
        f"learner with checks to without: {found['ratio']:.3f} "
        f"(quartiles {low:.3f} to {high:.3f} of {args.pairs} pairs of batches)"
    )
    config = {name: value for name, value in vars(args).items() if name != "out"}
    machine = {"machine": platform.machine(), "system": platform.system()}
    write_json(args.out, {"config": config, "machine": machine} | found)
    print(f"written: {args.out}")


if __name__ == "__main__":
    main()
