"""Random settings of teams from the whole range of every field, ends included."""

from typing import Any, get_type_hints

import numpy as np

from hmi_marl.checks import Real, Whole
from hmi_marl.envs.alerts import MOST_STRENGTHS, Fatigue
from hmi_marl.envs.attention import WINDOW
from hmi_marl.envs.config import Duration, TeamConfig
from hmi_marl.envs.drivers import TRAIT_RANGES, Driver, TraitDistributions, Uniform
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.envs.scene import EGO_START, Frequency, Scene

AT_AN_END = 0.25
"""Share of numbers that lie at an end of their range."""


def range_of(kind: Any, field: str | None = None) -> Whole | Real:
    """The range in an annotation, or in that of a dataclass's field."""
    hint = kind if field is None else get_type_hints(kind, include_extras=True)[field]
    while not hasattr(hint, "__metadata__"):
        hint = hint.__args__[0]  # of a union with None
    return hint.__metadata__[0]


def number(rng, within: Whole | Real) -> Any:
    """Any number of a range: evenly, or evenly in its logarithm where it spans decades."""
    whole = isinstance(within, Whole)
    low, high = (within.least, within.most) if whole else (within.low, within.high)
    if rng.random() < AT_AN_END:
        return high if rng.random() < 0.5 or (not whole and within.above) else low
    if low < 0 or high < 100 * max(low, 1):
        drawn = rng.uniform(low, high)
    else:
        drawn = np.exp(rng.uniform(np.log(max(low, 1e-6 * high)), np.log(high)))
    drawn = min(max(drawn, low), high)
    return round(drawn) if whole else float(drawn)


def of(rng, kind: type, *names: str) -> dict[str, Any]:
    """Numbers for these fields of a dataclass."""
    return {name: number(rng, range_of(kind, name)) for name in names}


def any_scene(rng, duration_steps: int | None = None) -> tuple[Scene, int]:
    """Any scene, and the steps of an episode in it, so many at most."""
    frequency = number(rng, range_of(Frequency))
    steps = int(3600 * frequency)
    steps = number(rng, Whole(1, steps if duration_steps is None else min(steps, duration_steps)))
    count = number(rng, Whole(2, 40))
    slowest = rng.uniform(1.0, 30.0)
    low, high = sorted(int(k) for k in rng.integers(0, 51, 2))
    scene = Scene(
        vehicles=max(1, high) if rng.random() < 0.3 else (low, max(1, high)),
        policy_frequency=frequency,
        simulation_frequency=frequency * number(rng, Whole(1, 1000 // frequency)),
        target_speeds=tuple(np.linspace(slowest, rng.uniform(slowest + 1.0, 40.0), count)),
        **of(rng, Scene, "lanes", "before", "converge", "parallel", "lidar_cells", "lidar_range"),
    )
    needed = EGO_START + steps / frequency * max(scene.target_speeds) - scene.merge_end
    allowed = range_of(Scene, "after")
    if rng.random() < 0.5:
        after = number(rng, Real(max(allowed.low, np.ceil(needed)), allowed.high))
        scene = Scene(**vars(scene) | {"after": after})
    return scene, steps


def any_drivers(rng) -> Any:
    """Several drivers, or a population."""
    ranges = dict(TRAIT_RANGES)
    if rng.random() < 0.5:
        each = {trait: sorted(number(rng, r) for _ in range(2)) for trait, r in ranges.items()}
        return TraitDistributions(**{trait: Uniform(*ends) for trait, ends in each.items()})
    return [Driver(f"d{k}", *(number(rng, r) for r in ranges.values())) for k in range(4)]


def any_config(rng, duration_steps: int | None = None) -> TeamConfig:
    """Any settings of teams."""
    scene, steps = any_scene(rng, duration_steps)
    strengths = np.sort(rng.random(number(rng, Whole(1, MOST_STRENGTHS)))) + 1e-9
    weights = of(rng, RewardWeights, *RewardWeights.__dataclass_fields__)
    fatigue = Fatigue(**of(rng, Fatigue, *Fatigue.__dataclass_fields__))
    return TeamConfig(
        driver=any_drivers(rng),
        observe_traits=bool(rng.random() < 0.5),
        ai_sees_attention=bool(rng.random() < 0.5),
        reward=str(rng.choice(["team", "individual", "driving", "attention"])),
        alert_window=number(rng, WINDOW),
        alert_strengths=(1.0,) if rng.random() < 0.4 else tuple(np.unique(strengths)),
        fatigue=fatigue if rng.random() < 0.5 else None,
        duration=min(steps / scene.policy_frequency, range_of(Duration).high),
        end_at_crash=bool(rng.random() < 0.7),
        scene=scene,
        weights=RewardWeights(**weights),
    )
