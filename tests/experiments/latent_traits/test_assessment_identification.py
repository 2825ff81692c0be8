from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from demonstrations import LAYOUT, made_up
from trait_models import untrained

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.trait_encoder import BEHAVIOUR, EncoderConfig
from hmi_marl.agents.learned.trait_model import TraitCard, TraitModel
from hmi_marl.demonstrations.dataset import MISSING, Demonstrations, disjoint_pools
from hmi_marl.envs.drivers import DRIVERS, TRAIT_NAMES
from hmi_marl.exact.identify import Identification
from hmi_marl.experiments.latent_traits import strangers
from hmi_marl.experiments.latent_traits.assessment import (
    WINDOWS,
    Split,
    identify_drivers,
    pool_sizes,
)
from hmi_marl.experiments.latent_traits.ceiling import likes_help
from hmi_marl.experiments.latent_traits.strangers import read_traits, strangers_pools
from hmi_marl.files import json_value
from hmi_marl.reporting.statistics import share

pytestmark = pytest.mark.usefixtures("few_folds")

NAMES = ("lisa", "marge", "bart")


def speed_reader(pool: int = 2) -> TraitModel:
    """z is the mean of speed and target speed over all steps."""
    one = NetworkConfig((1,))
    reads = tuple((part.name, part.size) for part in LAYOUT.parts)
    two = EncoderConfig(2, 2, 1, 2, head=NetworkConfig((2,)), average=one)
    card = TraitCard(reads, encoder=two, pool=pool, reward=one, potential=one, policy=one)
    weights = {name: np.zeros(size, np.float32) for name, size in card.shapes.items()}
    weights["state.scale"] += 1.0
    for unit, part in enumerate(("speed", "target_speed")):
        weights["encoder.state_layer.weight"][unit, LAYOUT[part].start] = 1.0
    weights["encoder.step_layer.weight"][:, BEHAVIOUR:] = np.eye(2)
    weights["encoder.span_layer.weight"][0] = np.eye(2)
    weights["encoder.head.layer0.weight"][:, :2] = np.eye(2)
    weights["encoder.head.layer1.weight"][:2] = np.eye(2)
    return TraitModel(card, weights)


def driven(
    counts: dict[str, int], length: int = 2, seed: int = 0, with_truth: bool = True
) -> Demonstrations:
    """Windows one driver after the other, each driver at a speed of their own, with their traits.

    Lisa and Bart like no help, Marge does.
    """
    driver = [list(counts).index(name) for name, count in counts.items() for _ in range(count)]
    data = made_up(
        [length] * len(driver), seed, driver=driver, names=tuple(counts), with_truth=with_truth
    )
    observed, who = data.observed, np.array(driver)
    rng, states = np.random.default_rng(seed), observed.states.copy()
    for part, place in (("speed", who % 3), ("target_speed", who % 2)):
        column = LAYOUT[part].start
        states[..., column] = 0.3 * place[:, None] + rng.uniform(0, 0.1, states.shape[:2])
    truth = data.truth
    if truth is not None:
        known = np.array([DRIVERS.get(name, DRIVERS["lisa"]).traits for name in counts])
        truth = replace(truth, traits=known[who])
    return Demonstrations(replace(observed, states=states), truth)


# Pools.


def test_pools_by_hand() -> None:
    driver = np.array([1, 0, 1, MISSING, 1, 0, 1, 1, 0, MISSING])
    # 0 drove 1, 5, 8 and 1 drove 0, 2, 4, 6, 7.
    np.testing.assert_array_equal(disjoint_pools(driver, 2), [[1, 5], [0, 2], [4, 6]])
    np.testing.assert_array_equal(disjoint_pools(driver, 3), [[1, 5, 8], [0, 2, 4]])
    np.testing.assert_array_equal(disjoint_pools(driver, 4), [[0, 2, 4, 6]])
    assert disjoint_pools(driver, 6).shape == (0, 6)
    assert disjoint_pools(np.full(3, MISSING), 2).shape == (0, 2)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_pools_share_no_window_and_have_one_driver(size: int) -> None:
    driver = np.random.default_rng(0).integers(-1, 4, 100)
    pools = disjoint_pools(driver, size)
    assert len(np.unique(pools)) == pools.size
    assert (driver[pools] == driver[pools[:, :1]]).all()
    assert (driver[pools] != MISSING).all()
    assert len(pools) == sum((driver == who).sum() // size for who in range(4))


def test_a_pool_is_averaged_over_all_steps() -> None:
    data = driven({"lisa": 3, "marge": 2})
    model = speed_reader()
    sums = model.encode(data.observed)
    speed, target = (
        data.observed.layout.scalar(data.observed.states, part)
        for part in ("speed", "target_speed")
    )
    z = np.stack([speed, target], axis=2).mean(axis=1)
    np.testing.assert_allclose(sums, np.concatenate([2 * z, np.full((5, 1), 2.0)], axis=1))
    pools = np.array([[0, 2], [3, 4]])
    expected = [(z[0] + z[2]) / 2, (z[3] + z[4]) / 2]
    np.testing.assert_allclose(model.latents(sums, pools).mean, expected, rtol=1e-6)
    np.testing.assert_array_equal(data.observed.driver, [0, 0, 0, 1, 1])


# What was learned from, and what was not.


def test_windows_that_are_judged_were_never_learned_from() -> None:
    data = driven({"lisa": 10, "marge": 5, "bart": 4})
    split = Split.of(data, 0.4, 100)
    learned, unseen = split.learned.observed, split.unseen.observed
    assert learned.seeds is not None
    assert unseen.seeds is not None
    assert not np.isin(unseen.seeds, learned.seeds).any()
    assert len(learned) + len(unseen) == 19
    np.testing.assert_array_equal(np.bincount(learned.driver), [6, 3, 2])
    np.testing.assert_array_equal(np.bincount(unseen.driver), [4, 2, 2])
    for who in range(3):  # the last ones are held out
        own = np.flatnonzero(data.observed.driver == who)
        assert data.observed.seeds is not None
        theirs = data.observed.seeds[own]
        both = [part.seeds[part.driver == who] for part in (learned, unseen)]
        np.testing.assert_array_equal(np.concatenate(both), theirs)
    assert split.unseen.truth is not None
    assert len(split.unseen.truth.traits) == 8


def test_at_most_so_many_windows_of_each_driver_are_taken() -> None:
    data = driven({"lisa": 10, "marge": 5, "bart": 4})
    whole, some = (Split.of(data, 0.4, most) for most in (100, 3))
    for part, all_of_it in ((some.learned, whole.learned), (some.unseen, whole.unseen)):
        first = all_of_it.observed.take(all_of_it.observed.number < 3)
        np.testing.assert_array_equal(part.observed.seeds, first.seeds)
    np.testing.assert_array_equal(np.bincount(some.learned.observed.driver), [3, 3, 2])
    np.testing.assert_array_equal(np.bincount(some.unseen.observed.driver), [3, 2, 2])


def test_nothing_held_out_is_nothing_to_judge_by() -> None:
    with pytest.raises(ValueError, match="no window was held out of training"):
        Split.of(driven({"lisa": 4, "marge": 4}), 0.0, 10)


def test_sizes_of_pools_by_hand() -> None:
    split = Split.of(driven({"lisa": 40, "marge": 30}), 0.5, 100)
    # 15 of marge's on either side; a z of two numbers takes four pools.
    assert pool_sizes(split, 1, 2) == (1, 2)
    assert pool_sizes(split, 3, 2) == (1, 2, 3)
    assert pool_sizes(split, 1, 1) == (1, 2, 4)
    assert pool_sizes(split, 15, -1) == (1, 2, 4, 8, 15)
    whole = Split.of(driven({"lisa": 200, "marge": 128}), 0.5, 1000)
    assert pool_sizes(whole, 8, 2) == WINDOWS


def test_too_few_windows_are_told_beforehand() -> None:
    split = Split.of(driven({"lisa": 40, "marge": 30}), 0.5, 100)
    with pytest.raises(ValueError, match=r"takes 16 of each .* of marge there are 15; demonstrate"):
        pool_sizes(split, 4, 2)
    few = Split.of(driven({"lisa": 40, "marge": 30}), 0.9, 100)
    with pytest.raises(ValueError, match="of marge there are 3"):
        pool_sizes(few, 1, 2)  # too few were learned from
    gone = Split.of(driven({"lisa": 40, "marge": 1}), 0.2, 100)
    with pytest.raises(ValueError, match="of marge there are 0"):
        pool_sizes(gone, 1, 2)
    with pytest.raises(ValueError, match="two or more who are known by name"):
        pool_sizes(Split.of(driven({"lisa": 40}), 0.5, 100), 1, 2)


# Who likes help.


def test_who_likes_help_by_hand() -> None:
    data = driven({"lisa": 2, "marge": 1, "bart": 1})
    assert data.truth is not None
    asked = likes_help(data)
    assert asked is not None
    assert asked.tolist() == [0, 0, 1, 0]
    eta = np.array([0.0, 0.4999, 0.5, 1.0])
    changed = data.truth.traits.copy()
    changed[:, TRAIT_NAMES.index("eta")] = eta
    asked = likes_help(Demonstrations(data.observed, replace(data.truth, traits=changed)))
    assert asked is not None
    assert asked.tolist() == [0, 0, 1, 1]
    assert likes_help(Demonstrations(data.observed)) is None


# Who drives.


def test_drivers_who_lie_apart_are_told_apart() -> None:
    split = Split.of(driven({"lisa": 20, "marge": 24, "bart": 20}), 0.5, 100)
    rows, embedding = identify_drivers(speed_reader(), split, None, (1, 2))
    assert [(row.windows, row.pools) for row in rows] == [(1, 32), (2, 16)]
    for row in rows:
        assert row.types.linear_probe == share(row.pools, row.pools)
        assert row.types.nearest_centroid == share(row.pools, row.pools)
        assert row.types.chance == 12 / 32
        assert row.preferences is not None
        assert row.preferences.linear_probe == share(row.pools, row.pools)
        assert row.preferences.chance == 20 / 32
        assert row.ceilings is None
        assert json_value(row)["ceilings"] is None
    assert rows[1].types.average_kl.mean > rows[0].types.average_kl.mean > 10
    # Of pools of the model's own size.
    unseen = split.unseen.observed
    pools = disjoint_pools(unseen.driver, 2)
    model = speed_reader()
    expected = model.latents(model.encode(unseen), pools).mean
    np.testing.assert_allclose(embedding.means, expected)
    np.testing.assert_array_equal(embedding.types, np.repeat([0, 1, 2], [5, 6, 5]))
    assert embedding.names == NAMES


def test_drivers_who_drive_alike_are_told_apart_by_chance() -> None:
    data = driven({"lisa": 200, "marge": 200})
    states = np.random.default_rng(1).permutation(data.observed.states)
    mixed = Demonstrations(replace(data.observed, states=states), data.truth)
    (row,), _ = identify_drivers(speed_reader(), Split.of(mixed, 0.5, 1000), None, (1,))
    assert row.types.chance == 0.5
    assert row.types.linear_probe.mean == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(200))
    assert row.types.average_kl.mean < 0.5


def test_the_ceiling_is_of_the_same_pools() -> None:
    data = driven({"lisa": 8, "marge": 8})
    split = Split.of(data, 0.5, 100)
    # By the evidence all are marge's, but for lisa's first two windows.
    odds = np.full((8, 2), [0.4, 0.6])
    odds[:2] = 0.9, 0.1
    found = Identification((DRIVERS["lisa"], DRIVERS["marge"]), np.log(odds))
    rows, _ = identify_drivers(untrained(LAYOUT, pool=1), split, found, (1,))
    assert rows[0].ceilings is not None
    assert rows[0].ceilings.identity == rows[0].ceilings.preference == share(6, 8)
    with pytest.raises(ValueError, match="4 vectors of each type or more"):
        identify_drivers(untrained(LAYOUT, pool=1), split, found, (2,))


def test_preferences_are_asked_where_they_are_known_and_differ() -> None:
    for data in (
        driven({"lisa": 8, "marge": 8}, with_truth=False),
        driven({"lisa": 8, "bart": 8}),  # neither likes help
    ):
        rows, _ = identify_drivers(speed_reader(1), Split.of(data, 0.5, 100), None, (1,))
        assert rows[0].preferences is None
        assert json_value(rows[0])["preferences"] is None


def test_windows_of_nobody_are_not_judged() -> None:
    data = driven({"lisa": 8, "marge": 8})
    nobody = np.where(np.arange(16) % 8 < 1, MISSING, data.observed.driver)
    nobody[[7, 15]] = MISSING
    some = Demonstrations(replace(data.observed, driver=nobody), data.truth)
    rows, _ = identify_drivers(untrained(LAYOUT, latent=1), Split.of(some, 0.5, 100), None, (1,))
    assert rows[0].pools == 6


# Traits of drivers who were not learned from.


def random_drivers(count: int = 12, windows: int = 2, seed: int = 0) -> Demonstrations:
    """β and inflation follow from the speed; α and η from nothing that is seen."""
    data = driven({f"population-{k}": windows for k in range(count)}, seed=seed)
    assert data.truth is not None
    rng, who = np.random.default_rng(seed), data.observed.driver
    drawn = rng.uniform(0, 1, (count, 4))
    states = data.observed.states.copy()
    states[..., LAYOUT["speed"].start] = 0.5 * drawn[who, :1]
    drawn[:, 3] = 1.0 + 9.0 * drawn[:, 0]
    return Demonstrations(
        replace(data.observed, states=states), replace(data.truth, traits=drawn[who])
    )


def test_what_can_be_read_from_z_is_told_of_every_trait() -> None:
    found = read_traits(speed_reader(), random_drivers(60), 2).r2
    assert tuple(found) == TRAIT_NAMES
    for name in ("beta", "inflation"):
        assert found[name].linear.mean > 0.95
    for name in ("alpha", "eta"):
        assert found[name].linear.mean < 0.3


def test_no_driver_is_on_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    given: dict[str, Any] = {}

    def record(
        z: Any, known: Any, new: Any, truth: Any, names: Any, seed: int, predicted: Any
    ) -> dict[str, Any]:
        assert predicted.shape == truth.shape
        given.update(z=z, known=known, new=new, truth=truth, names=names, seed=seed)
        return {}

    monkeypatch.setattr(strangers, "trait_r2", record)
    population = random_drivers(7, windows=5)
    read_traits(speed_reader(), population, 2, seed=3)
    assert (given["names"], given["seed"]) == (TRAIT_NAMES, 3)
    sides = [np.unique(given[side], axis=0) for side in ("known", "truth")]
    assert [len(side) for side in sides] == [4, 3]
    assert len(np.unique(np.concatenate(sides), axis=0)) == 7
    assert (len(given["z"]), len(given["new"])) == (8, 6)  # two pools of each
    # Each z beside its driver's traits: the speed is half of β.
    for z, known in ((given["z"], given["known"]), (given["new"], given["truth"])):
        np.testing.assert_allclose(z[:, 0], 0.5 * known[:, 0], rtol=1e-5)


def test_halves_are_equal_whoever_has_too_few_windows() -> None:
    # Every other driver has a single window, and so no pool of two.
    data = random_drivers(8)
    kept = (data.observed.driver % 2 == 0) | (data.observed.number == 0)
    found = read_traits(speed_reader(), data.take(kept), 2).r2
    whole = read_traits(speed_reader(), data.take(data.observed.driver % 2 == 0), 2).r2
    assert found == whole
    assert np.isfinite(found["beta"].linear.mean)


def test_a_population_that_tells_too_little_is_refused() -> None:
    with pytest.raises(ValueError, match="only where the truth is known"):
        read_traits(speed_reader(), Demonstrations(random_drivers().observed), 2)
    with pytest.raises(ValueError, match=r"4 drivers or more with 2 windows each, but .* has 3"):
        read_traits(speed_reader(), random_drivers(3), 2)
    with pytest.raises(ValueError, match=r"4 drivers or more with 3 windows each, but .* has 0"):
        strangers_pools(random_drivers().observed.driver, 3)
    pools, fits = strangers_pools(random_drivers().observed.driver, 2)
    assert pools.shape == (12, 2)
    assert fits.sum() == 6
