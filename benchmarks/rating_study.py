"""False alarms and recovery of the rating study's analysis, by simulated raters.

Whole studies are simulated and judged as ``hmi-marl study analyse`` does, all intended differences
together: once without any difference, once with a planted one for each contrast, and both again for
a small study of few raters and clips::

    python benchmarks/rating_study.py --studies 200 --out runs/rating-study-simulated.json

prints how often some difference is found that was not planted, in either direction, how often
planted ones are found, the mean error of the estimates, and how many 95 % intervals hold the true
difference. All of it is simulated. It takes about a minute of one core.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from hmi_marl.files import write_json
from hmi_marl.people.study.power import SimulatedStudies, simulate_studies
from hmi_marl.people.study.settings import Plan, StudySettings
from hmi_marl.reporting.statistics import Estimate, share
from hmi_marl.reporting.verdicts import Outcome

STUDIES = {
    "default: 20 clips of each, 100 raters": (StudySettings(), 100),
    "small: 5 clips of each, 25 raters": (StudySettings(clips=5), 25),
}


def any_is(found: SimulatedStudies, *outcomes: Outcome) -> Estimate:
    """Share of studies in which some contrast has one of these outcomes."""
    is_so = np.isin(found.outcomes, [str(each) for each in outcomes]).any(axis=1)
    return share(int(is_so.sum()), len(is_so))


def row(name: str, effect: float, found: SimulatedStudies) -> dict[str, object]:
    """Numbers of some simulated studies, printed."""
    alarms = any_is(found, Outcome.SUPPORTED)
    reversed_ones = any_is(found, Outcome.NOT_SUPPORTED)
    held = share(int(found.covered.sum()), found.covered.size)
    errors = found.found.mean(axis=0) - found.truth
    supported = [found.supported(place).mean for place in range(len(found.truth))]
    print(f"\n{name}, {effect:g} points planted ({found.truth.mean():.2f} after rounding)")
    print(f"  studies in which some difference is supported: {alarms.percent()} %")
    print(f"  studies in which some difference is reversed: {reversed_ones.percent()} %")
    print(f"  contrasts that are supported: {100 * np.mean(supported):.1f} %")
    print(f"  95 % intervals that hold the true difference: {held.percent()} %")
    print(f"  mean error of a contrast: {errors.min():+.3f} to {errors.max():+.3f} points")
    return {
        "study": name,
        "effect": effect,
        "truth": found.truth.tolist(),
        "any_supported": alarms.as_json(),
        "any_reversed": reversed_ones.as_json(),
        "supported": supported,
        "covered": held.as_json(),
        "errors": errors.tolist(),
    }


def main() -> None:
    """Simulate, judge, print and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--studies", type=int, default=200)
    parser.add_argument("--effect", type=float, default=0.6)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("runs/rating-study-simulated.json"))
    options = parser.parse_args()
    began = time.process_time()
    print(f"SIMULATED raters, {options.studies} studies in each row")
    rows = []
    for name, (settings, raters) in STUDIES.items():
        for effect in (0.0, options.effect):
            plan = Plan(effect=effect)
            found = simulate_studies(settings, plan, raters, options.studies, options.seed)
            rows.append(row(name, effect, found))
    print(f"\n{time.process_time() - began:.0f} s of one core")
    write_json(options.out, {"simulated": True, "seed": options.seed, "rows": rows})


if __name__ == "__main__":
    main()
