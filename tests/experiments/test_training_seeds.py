"""Results of several training seeds, averaged, and what is stated of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hmi_marl.checks import Count
from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.streams import Seed
from hmi_marl.experiments.experiment import Place
from hmi_marl.experiments.training_seeds import (
    Repeated,
    SeededExperiment,
    learned_part,
    over_seeds,
)
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Text
from hmi_marl.reporting.statistics import UNKNOWN, Estimate
from hmi_marl.reporting.verdicts import EPISODES, SEEDS, Part, Verdict


class Pair(NamedTuple):
    least: float
    most: float


@dataclass(frozen=True)
class Row:
    name: str
    gain: Estimate
    exact: float
    maybe: float | None
    ends: Pair
    by_driver: dict[str, list[float]]


def row(number: int, **more: Any) -> Row:
    gain = statistics.mean(np.array([0.0, 2.0, 4.0]) + number)
    return replace(
        Row(
            f"run {number}",
            gain,
            0.1,
            None,
            Pair(float(number), 9.0),
            {"lisa": [1.0, float(number)]},
        ),
        **more,
    )


def test_one_seed_stays_as_it_is() -> None:
    only = row(1)
    assert over_seeds([only]) is only


def test_numbers_are_averaged_and_names_are_those_of_the_first() -> None:
    found = over_seeds([row(1), row(2), row(6)])
    assert found.name == "run 1"
    assert found.gain.mean == pytest.approx(5.0)
    assert found.gain.count == 3
    assert found.ends == Pair(3.0, 9.0)
    assert found.by_driver == {"lisa": [1.0, 3.0]}
    assert found.maybe is None
    assert found.exact == 0.1  # to the last bit, where all are the same
    assert over_seeds([row(1, maybe=1.0), row(2, maybe=2.0)]).maybe == 1.5
    assert over_seeds([row(1, maybe=1.0), row(2)]).maybe is None
    assert over_seeds([DRIVERS["lisa"]] * 3) == DRIVERS["lisa"]


def test_the_interval_is_over_seeds_with_the_luck_of_the_episodes_they_share() -> None:
    rows = [row(number) for number in (1, 2, 6)]
    found = over_seeds(rows).gain
    between = np.std([3.0, 4.0, 8.0], ddof=1) / math.sqrt(3)
    within = np.std([0.0, 2.0, 4.0], ddof=1) / math.sqrt(3)
    assert between < found.error
    assert found.error == pytest.approx(math.hypot(between, within * 4.303 / 1.96), rel=1e-3)
    assert found == statistics.mean_of_same([each.gain for each in rows])


def test_shares_keep_the_luck_of_their_trials() -> None:
    never = [statistics.share(0, 100)] * 3
    assert over_seeds(never) == statistics.mean_share(never)
    assert over_seeds(never).high > 0.0


def test_what_is_the_same_in_every_seed_was_not_touched_by_training() -> None:
    same = statistics.mean([1.0, 2.0, 4.0, 8.0])
    assert over_seeds([same] * 3).count == 4
    part = learned_part("gain", over_seeds([same] * 3), 3, above=0.0)
    assert (part.unit, part.count, part.seeds) == (EPISODES, 4, 3)


def test_what_one_seed_does_not_know_is_not_known() -> None:
    assert math.isnan(over_seeds([row(1).gain, UNKNOWN]).mean)


@pytest.mark.parametrize(
    ("ones", "others", "told"),
    [
        ([1.0], [1.0, 2.0], "lengths"),
        ({"a": 1.0}, {"b": 1.0}, "names"),
        (1.0, "one", "kind"),
    ],
)
def test_results_of_different_shapes_are_refused(ones: Any, others: Any, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        over_seeds([ones, others])


def test_a_part_names_its_unit() -> None:
    one, several = row(1).gain, over_seeds([row(1), row(2)]).gain
    assert (learned_part("gain", one, 1).unit, learned_part("gain", one, 1).seeds) == (EPISODES, 1)
    assert (learned_part("gain", several, 2).unit, learned_part("gain", several, 2).count) == (
        SEEDS,
        2,
    )
    assert learned_part("crashes", statistics.share(1, 9), 1, alone=Part.share).test == "Wilson"
    assert learned_part("gain", one, 1, "drivers").unit == "drivers"


def test_a_mean_of_shares_over_seeds_has_an_interval_that_ends_at_0() -> None:
    crashes = over_seeds([statistics.share(hits, 1000) for hits in (1, 9, 30)])
    part = learned_part("crashes", crashes, 3, alone=Part.share, below=0.1)
    assert (part.test, part.unit) == ("t of shares", SEEDS)
    assert part.interval(0.999)[0] == 0.0
    assert learned_part("gap closed", crashes, 3).interval(0.999)[0] < 0.0


@dataclass(frozen=True)
class Drawn(SeededExperiment[Row]):
    """An experiment whose result is its seed."""

    seed: Seed = 3
    seeds: Count = 3

    name = "drawn"
    title = "Drawn"

    @classmethod
    def quick(cls) -> Drawn:
        return cls(seeds=1)

    def learn(self, each: Sequence[tuple[Drawn, Place]], place: Place) -> None:
        for alone, where in each:
            where.folder.mkdir(exist_ok=True)
            (where.folder / "learned").write_text(str(alone.seed))

    def play(self, place: Place) -> Row:
        with place.playing(1, "rows"):
            place.watch.seconds["counted"] = 2.0
        return row(int((place.folder / "learned").read_text()) % 97)

    def numbers_of(self, results: Row) -> dict[str, Any]:
        return {"gain": results.gain.mean}

    def judge_of(self, results: Row) -> list[Verdict]:
        return [Verdict("gains", (learned_part("gain", results.gain, self.seeds, above=0.0),))]

    def blocks_of(self, results: Row) -> list[Text]:
        return [Text(results.gain.shown())]


def test_each_seed_learns_in_its_folder_and_the_first_in_the_experiments(tmp_path: Path) -> None:
    place = Place(tmp_path, tmp_path)
    experiment = Drawn()
    found = experiment.run(place)
    seeds = [int((tmp_path / name / "learned").read_text()) for name in (".", "seed-1", "seed-2")]
    assert seeds[0] == 3
    assert len(set(seeds)) == 3
    numbers = experiment.numbers(found)
    assert numbers["training_seeds"] == 3
    assert numbers["gain"] == pytest.approx(np.mean([each["gain"] for each in numbers["by_seed"]]))
    (verdict,) = experiment.judge(found)
    assert "3 training seeds" in verdict.basis
    # More seeds go on from fewer, and one is the first of several.
    (first,) = Drawn(seeds=1).run(place).by_seed
    assert found.by_seed[0] == first
    assert "by_seed" not in Drawn(seeds=1).numbers(Repeated((first,)))


def test_seeds_are_played_side_by_side(tmp_path: Path) -> None:
    one, three = Place(tmp_path, tmp_path), Place(tmp_path, tmp_path, workers=3)
    assert Drawn().run(three) == Drawn().run(one)
    assert three.watch.seconds["counted"] == 3 * 2.0  # durations of all of them add up
    assert three.watch.seconds["playing"] > 0.0
