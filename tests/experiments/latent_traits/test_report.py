import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cited import missing
from foreign_texts import FOREIGN

from hmi_marl.envs.drivers import TRAIT_NAMES
from hmi_marl.experiments.experiment import Place, conduct
from hmi_marl.experiments.latent_traits import figures
from hmi_marl.experiments.latent_traits import tables as trait_tables
from hmi_marl.experiments.latent_traits.assessment import Assessment, Embedding, Identified
from hmi_marl.experiments.latent_traits.ceiling import Ceilings
from hmi_marl.experiments.latent_traits.divergence import average_kl
from hmi_marl.experiments.latent_traits.evaluation import TraitEvaluation
from hmi_marl.experiments.latent_traits.figures import embeddings_figure
from hmi_marl.experiments.latent_traits.imitation import ActionLikelihood, Driving, DrivingRow
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow, TraitScore
from hmi_marl.experiments.latent_traits.prediction import ActionPrediction
from hmi_marl.experiments.latent_traits.probes import Separability, TraitR2
from hmi_marl.experiments.latent_traits.report import left_out
from hmi_marl.experiments.latent_traits.results import TraitResults
from hmi_marl.experiments.latent_traits.reward import Ranks, RewardRanking
from hmi_marl.experiments.latent_traits.strangers import Naming, TraitReading
from hmi_marl.experiments.latent_traits.tables import (
    accuracy_figure,
    driving_table,
    identity_table,
    likelihood_table,
    naming_table,
    prediction_table,
    ranking_table,
    trait_table,
)
from hmi_marl.experiments.latent_traits.trait_figures import draw_reading
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import as_text
from hmi_marl.reporting.report import PAGE, Stopwatch
from hmi_marl.reporting.statistics import Estimate, share
from hmi_marl.reporting.verdicts import SEEDS, Part, Verdict, judged_together

REPORT = TraitEvaluation((), Path())

NOT_KNOWN = Estimate(math.nan, math.nan, math.nan)
NAMES = ("lisa", "marge<b>", "bart", "homer")
POOL = 8
OPEN = Part.mean("x", statistics.mean([-1.0, 1.0]), SEEDS, above=0.0)


def about(mean: float, half: float = 0.1) -> Estimate:
    return Estimate(mean, mean - half, mean + half)


def identified(
    windows: int, hits: int, kl: float, likes: int | None = 90, best: tuple[int, int] | None = None
) -> Identified:
    def kept_apart(right: int, chance: float) -> Separability:
        apart = statistics.by_logarithm(kl, 0.001, 100)
        return Separability(share(right, 100), share(right - 1, 100), chance, 0.5, 0.25, apart)

    return Identified(
        windows,
        100,
        kept_apart(hits, 0.25),
        None if likes is None else kept_apart(likes, 0.5),
        None if best is None else Ceilings(share(best[0], 100), share(best[1], 100)),
    )


def reading(**network: float) -> TraitReading:
    """Twenty pools of ten strangers; R² by trait."""
    rng = np.random.default_rng(1)
    traits = rng.random((20, 4))
    r2 = {
        name: TraitR2(about(mean - 0.125), about(mean), about(mean + 0.125))
        for name, mean in network.items()
    }
    return TraitReading(rng.normal(size=(20, 3)), traits, traits, 10, r2)


def one(
    supervision: str = "none",
    hits: int = 60,
    kl: float = 10.0,
    likes: int | None = 90,
    best: tuple[int, int] | None = (90, 95),
    **changed: Any,
) -> Assessment:
    """An assessment with pools of one and eight windows."""
    rng = np.random.default_rng(0)
    types = np.repeat(np.arange(4), 5)
    embedding = Embedding(types[:, None] + rng.normal(size=(20, 2)), types, NAMES)
    drives = Driving(9, about(20.25), about(1.5), about(6.0), about(0.5), NOT_KNOWN, share(1, 9))
    content: dict[str, Any] = {
        "supervision": supervision,
        "identified": [
            identified(1, 30, 1.0, likes, best),
            identified(POOL, hits, kl, likes, best),
        ],
        "embedding": embedding,
        "likelihood": [
            ActionLikelihood(
                "lisa", 4, about(-1.0), about(-1.5), about(0.5), about(-0.5), about(0.5)
            ),
            ActionLikelihood("marge<b>", 4, about(-1.25), about(-1.5), about(0.25)),
        ],
        "driving": [DrivingRow("lisa", drives, replace(drives, speed=about(19.0)))],
        "reward_ranking": [
            RewardRanking(
                "lisa", 5, Ranks(NOT_KNOWN, about(0.25)), Ranks(about(0.75), about(0.5)), {}
            )
        ],
        "reading": reading(beta=0.5, eta=math.nan),
        "naming": [Naming(1, share(90, 100), 0.25), Naming(POOL, share(99, 100), 0.25)],
    }
    return Assessment(**(content | changed))


THREE = {
    "none": [one()],
    "id": [one("id", hits=88, kl=80.0)],
    "preference": [one("preference", hits=60, kl=70.0, likes=94)],
}
ALL = TraitResults(THREE, POOL)
EMBEDDINGS = {name: one.embedding for name, one in ALL.first.items()}


def results(**assessments: list[Assessment]) -> TraitResults:
    return TraitResults(assessments, POOL)


def judged(found: TraitResults) -> dict[str, str]:
    """Outcomes by claim, but for those on rewards."""
    verdicts = {verdict.claim: str(verdict.outcome) for verdict in REPORT.judge(found)}
    return {claim: outcome for claim, outcome in verdicts.items() if "reward" not in claim}


def kl_of(row: Identified, factor: float, error: float) -> Estimate:
    kl = row.types.average_kl
    return statistics.by_logarithm(kl.mean * factor, error, kl.count)


def seeds(
    found: Mapping[str, Sequence[Assessment]], count: int = 5, error: float = 0.001
) -> TraitResults:
    """The same with as many training seeds, alike but for little.

    ``error`` is that of the logarithm of KL within a seed.
    """
    spread = {
        name: [
            replace(
                each,
                identified=[
                    replace(row, types=replace(row.types, average_kl=kl_of(row, factor, error)))
                    for row in each.identified
                ],
            )
            for each in several
            for factor in np.linspace(0.99, 1.01, count)
        ]
        for name, several in found.items()
    }
    return TraitResults(spread, POOL)


def text_of(found: TraitResults) -> str:
    """The report's text, without verdicts."""
    return as_text(REPORT.blocks(found))


# Over seeds.


def test_seeds_are_averaged() -> None:
    # Standard error 1, one degree of freedom: t = 12.7062.
    found = statistics.mean([2.0, 4.0])
    assert (found.mean, found.low) == pytest.approx((3.0, 3.0 - 12.7062), abs=1e-4)
    alone = statistics.mean([5.0])
    assert (alone.mean, alone.count) == (5.0, 1)
    assert math.isnan(alone.low), "one seed has no interval, not one of no width"


def test_accuracies_are_over_pools_of_one_seed_or_over_several_seeds() -> None:
    single, several = [one(hits=60)], [one(hits=60), one(hits=70), one(hits=80)]
    found = results(none=single, id=several)
    assert found.accuracy("none", POOL) == share(60, 100)
    assert found.accuracy("none", 1) == share(30, 100)
    assert found.accuracy("none", POOL, "preferences") == share(90, 100)
    of_seeds = [share(60, 100), share(70, 100), share(80, 100)]
    assert found.accuracy("id", POOL) == statistics.mean_share(of_seeds)
    alike = found.accuracy("id", 1)  # the luck of the pools is left
    assert alike == statistics.mean_share([share(30, 100)] * 3)
    assert alike.low < 0.3 < alike.high


def test_kl_is_averaged_over_seeds() -> None:
    found = results(none=[one(kl=10.0)], id=[one(kl=10.0), one(kl=20.0)])
    assert found.average_kl("none", POOL).mean == 10.0
    assert math.isnan(found.average_kl("none", POOL).low)
    of_seeds = [statistics.by_logarithm(kl, 0.001, 100) for kl in (10.0, 20.0)]
    assert found.average_kl("id", POOL) == statistics.mean_of_same(of_seeds)
    assert found.average_kl("id", POOL).luck == pytest.approx(0.015, rel=0.02)  # nats: a thousandth
    assert found.average_kl("none", 1).mean == 1.0


# Claims.

CLAIMS = [
    "by driver: accuracy within 3 points of the ceiling",
    "by preference: of preferences within 2 points of the ceiling",
    "unsupervised: 20 points above chance",
    "by driver: KL 6 times the unsupervised one",
    "by preference: KL 6 times the unsupervised one",
    "KL in the paper's order: unsupervised < by preference < by driver",
]


def test_what_holds_over_seeds() -> None:
    good = {
        "none": [one(hits=70)],
        "id": [one("id", hits=99, kl=80.0)],
        "preference": [one("preference", likes=100, kl=70.0)],
    }
    assert judged(seeds(good)) == dict.fromkeys(CLAIMS, "supported")
    part = REPORT.judge(seeds(good))[0].parts[0]
    assert (part.unit, part.count, part.seeds) == ("training seeds", 5, 5)
    assert part.above == pytest.approx(0.87)


def test_what_is_missed_over_seeds() -> None:
    missed = {
        "none": [one(hits=30)],
        "id": [one("id", hits=70, kl=59.0)],
        "preference": [one("preference", likes=80, kl=0.0)],
    }
    assert judged(seeds(missed)) == dict.fromkeys(CLAIMS, "not supported")


def test_one_seed_says_nothing_of_a_way_of_learning() -> None:
    assert judged(ALL) == dict.fromkeys(CLAIMS, "undetermined")
    assert all("1 seed: undetermined" in verdict.summary for verdict in REPORT.judge(ALL))


def test_claims_are_of_the_size_of_the_pools() -> None:
    # 30 % of single windows is five points above chance.
    single = TraitResults(seeds({"none": [one(hits=70)]}).assessments, 1)
    assert judged(single) == {CLAIMS[2]: "not supported"}


def test_settings_that_are_not_there_claim_nothing() -> None:
    supervised = {name: THREE[name] for name in ("id", "preference")}
    assert list(judged(results(**supervised))) == CLAIMS[:2]
    assert list(judged(results(id=THREE["id"]))) == CLAIMS[:1]


def test_without_a_ceiling_or_preferences_nothing_is_claimed_of_them() -> None:
    no_ceiling = {name: [one(name, best=None)] for name in ("id", "preference")}
    assert judged(results(**no_ceiling)) == {}
    alike = {"preference": [one("preference", likes=None)]}
    assert judged(results(**alike)) == {}


def test_vectors_that_are_all_one_are_no_division_by_zero() -> None:
    def kl(unsupervised: float, supervised: float) -> str:
        both = {"none": [one(kl=unsupervised)], "id": [one("id", kl=supervised)]}
        return judged(seeds(both))["by driver: KL 6 times the unsupervised one"]

    assert kl(0.0, 5.0) == "supported"
    assert kl(0.0, 0.0) == "not supported"


def test_ratios_of_kl_keep_the_luck_of_the_pools_that_all_seeds_share() -> None:
    both = {"none": [one(kl=10.0)], "id": [one("id", kl=80.0)]}
    claim = "by driver: KL 6 times the unsupervised one"
    assert judged(seeds(both, error=0.01))[claim] == "supported"
    assert judged(seeds(both, error=0.2))[claim] == "undetermined"
    part = next(v for v in REPORT.judge(seeds(both, error=0.2)) if v.claim == claim).parts[0]
    assert (part.luck, part.luck_count) == (pytest.approx(0.2 * math.sqrt(2)), 100)
    assert "over what they share, 100 units" in part.basis()
    content = seeds(both, error=0.2).as_json()["supervisions"]["id"]
    kl = next(row for row in content["seeds"][0]["identified"] if row["windows"] == POOL)
    assert kl["types"]["average_kl"]["error"] == 0.2
    assert content["average_kl"]["luck"] == pytest.approx(0.2 * 80.0, rel=0.05)


def test_intervals_of_accuracies_end_at_1_however_sure_they_have_to_be() -> None:
    found = results(id=[one("id", hits=hits) for hits in (95, 99, 100, 98, 99)])
    verdict = next(v for v in REPORT.judge(found) if v.claim.startswith("by driver: accuracy"))
    together = judged_together([verdict, *[Verdict("x", (OPEN,))] * 50])[0]
    assert together.as_json()["intervals"][0][1] == 1.0
    assert "100.0%]" in together.summary


def test_the_order_of_kl_takes_every_pair_of_neighbours() -> None:
    def order(driver: float, preference: float) -> str:
        labelled = [one("id", kl=driver)], [one("preference", kl=preference)]
        return judged(seeds({"none": [one()], "id": labelled[0], "preference": labelled[1]}))[
            CLAIMS[-1]
        ]

    assert order(80.0, 70.0) == "supported"
    assert order(70.0, 80.0) == order(80.0, 5.0) == "not supported"


def test_rewards_are_judged_by_the_driver_for_whom_they_rank_worst() -> None:
    def rewards(*ranks: float) -> dict[str, str]:
        rows = [
            RewardRanking(
                f"{k}", 5, Ranks(NOT_KNOWN, NOT_KNOWN), Ranks(about(rank, 0.01), about(rank)), {}
            )
            for k, rank in enumerate(ranks)
        ]
        found = REPORT.judge(seeds({"self": [one("self", reward_ranking=rows, reading=None)]}))
        return {str(v.outcome): v.claim for v in found if "reward" in v.claim}

    claim = "self-supervised: the reward ranks driving, correlation at least 0.7"
    assert rewards(0.8, 0.75) == {"supported": claim}
    assert rewards(0.8, 0.65) == {"not supported": claim}
    assert rewards() == {}
    (alone,) = (v for v in REPORT.judge(results(none=[one()])) if "reward" in v.claim)
    assert str(alone.outcome) == "undetermined"  # one seed


def test_what_z_loses_against_the_true_traits_is_judged() -> None:
    def lost(nats: float) -> str:
        prediction = ActionPrediction(*(about(v, 0.001) for v in (-0.7, -0.7, -0.8, nats)))
        found = REPORT.judge(seeds({"self": [one("self", prediction=prediction, reading=None)]}))
        return str(next(v.outcome for v in found if "predicts actions" in v.claim))

    assert lost(0.005) == "supported"
    assert lost(0.05) == "not supported"
    assert lost(0.02) == "undetermined"


# Tables.


def test_rows_of_who_drives_by_hand() -> None:
    table = identity_table(ALL)
    rows = table.rows
    assert all(len(row) == len(table.head) for row in rows)
    assert [row[:2] for row in rows] == [
        [title, size]
        for title in ("unsupervised", "by driver", "by preference")
        for size in ("1", "8")
    ]
    # Wilson: 88 of 100.
    assert rows[3] == [
        "by driver",
        "8",
        "88.0 [80.2, 93.0]",
        "90.0 [82.6, 94.5]",
        "87.0",
        "90.0 [82.6, 94.5]",
        "95.0 [88.8, 97.8]",
        "0.50",
        "0.25",
        "80",
        "4940",
    ]
    assert rows[2][-1] == "", "the paper's are of pools"
    assert rows[1][-1] == "435"


def test_what_is_not_known_is_a_dash() -> None:
    (row, _) = identity_table(results(id=[one("id", likes=None, best=None)])).rows
    assert (row[3], row[5], row[6]) == ("-", "-", "-")
    (row, _) = identity_table(results(id=[one("id", likes=None)])).rows
    assert (row[5], row[6]) == ("-", "-")
    assert trait_table(results(id=[one("id")])).rows[1][1:] == ["eta", *["-"] * 5]


def test_rows_of_the_other_tables_by_hand() -> None:
    both = results(none=[one()])
    assert trait_table(both).rows[0] == [
        "unsupervised",
        "beta",
        "0.38 [0.28, 0.47]",
        "0.50 [0.40, 0.60]",
        "0.62 [0.53, 0.72]",
        "-",
        "-",
    ]
    assert likelihood_table(both).rows == [
        [
            "unsupervised",
            "lisa",
            "-1.000 [-1.100, -0.900]",
            "-1.500 [-1.600, -1.400]",
            "0.500 [0.400, 0.600]",
            "-0.500 [-0.600, -0.400]",
            "0.500 [0.400, 0.600]",
        ],
        [
            "unsupervised",
            "marge<b>",
            "-1.250 [-1.350, -1.150]",
            "-1.500 [-1.600, -1.400]",
            "0.250 [0.150, 0.350]",
            "-",
            "-",
        ],
    ]
    assert driving_table(both).rows == [
        [
            "unsupervised",
            "lisa",
            "19 / 20.2",
            "1.5 / 1.5",
            "6 / 6",
            "0.5 / 0.5",
            "- / -",
            "0.111 / 0.111",
        ]
    ]
    assert ranking_table(both).rows == [
        ["unsupervised", "lisa", "-", "0.25 [0.15, 0.35]", "0.75 [0.65, 0.85]", "0.50 [0.40, 0.60]"]
    ]
    for show in (
        trait_table,
        prediction_table,
        likelihood_table,
        driving_table,
        ranking_table,
    ):
        table = show(both)
        assert all(len(row) == len(table.head) for row in table.rows)


def exact(**r2: float) -> PosteriorRow:
    scores = {name: TraitScore(about(mean, 0.05), (), ()) for name, mean in r2.items()}
    return PosteriorRow("hidden-known", POOL, 20.0, 7, scores, 500.0, 1.0)


def test_the_exact_posterior_stands_beside_with_the_ratio() -> None:
    found = TraitResults({"none": [one()]}, POOL, posterior=exact(beta=0.9, eta=0.5))
    table = trait_table(found)
    assert table.rows[0][-2:] == ["0.90 [0.85, 0.95]", "0.69"]  # 0.625 / 0.9
    assert table.note == "10 strangers in pools of 8; exact: the posterior's mean, for 7 of them"
    assert REPORT.numbers(found)["posterior"]["traits"]["beta"]["r2"]["mean"] == 0.9


def test_r2_and_naming_are_averaged_over_seeds() -> None:
    found = results(self=[one("self"), one("self", reading=reading(beta=0.7, eta=0.0))])
    r2 = [about(0.625), about(0.825)]
    assert found.trait_r2("self", "beta", "network") == statistics.mean_of_same(r2)
    named = found.averaged("self", "naming")[1].named
    assert named == statistics.mean_share([share(99, 100)] * 2)
    assert REPORT.numbers(found)["supervisions"]["self"]["naming"][1]["named"]["count"] == 2
    assert trait_table(found).rows[0][2].startswith("0.47 [")  # (0.375 + 0.575) / 2
    assert [row[:4:2] for row in naming_table(found).rows] == [
        ["self-supervised", "90.0 [84.0, 96.0]"],
        ["self-supervised", "99.0 [96.8, 100.0]"],
    ]


def test_the_self_supervised_setting_is_judged_by_strangers() -> None:
    read = reading(beta=0.99, alpha=0.75, eta=0.65, inflation=1.01)
    several = [one("self", reading=read, reward_ranking=[])] * 2
    verdicts = REPORT.judge(results(self=several))
    assert "at least beta 0.85, alpha 0.60, eta 0.50, inflation 0.88" in verdicts[0].claim
    assert [part.above for part in verdicts[0].parts] == [0.85, 0.60, 0.50, 0.88]
    assert [part.seeds for verdict in verdicts for part in verdict.parts] == [2] * 10
    for verdict in REPORT.judge(results(self=several[:1])):
        assert verdict.outcome == "undetermined"
        assert "1 seed: undetermined for training" in verdict.summary


def test_strangers_are_drawn() -> None:
    read = reading(**dict.fromkeys(TRAIT_NAMES, 0.5))
    blocks = REPORT.blocks(results(self=[one("self", reading=read)]))
    (figure,) = [block for block in blocks if getattr(block, "name", "") == "strangers-self"]
    assert figure.drawn.startswith(b"\x89PNG")
    drawn = draw_reading(read)
    assert len(drawn.axes) == 3 * 4  # two panels and a scale of colours for each trait
    dots = drawn.axes[4].collections[0].get_offsets()
    np.testing.assert_allclose(dots[:, 1], read.predicted[:, 0])


def test_no_population_no_rows() -> None:
    assert trait_table(results(none=[one(reading=None)])).rows == []


# Text and JSON.


def report_of(found: TraitResults, folder: Path, monkeypatch: pytest.MonkeyPatch, **place: Any):
    """Report of these results, as an experiment writes it."""
    monkeypatch.setattr(TraitEvaluation, "check", lambda self, place: None)
    monkeypatch.setattr(TraitEvaluation, "run", lambda self, place: found)
    settings = {"windows": "<5>"}
    monkeypatch.setattr(TraitEvaluation, "settings", lambda self: settings)
    return conduct(TraitEvaluation((), folder), Place(folder, folder, **place))


def test_the_text_holds_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watch = Stopwatch()
    watch.seconds["judging"] = 61.6
    text = report_of(ALL, tmp_path, monkeypatch, watch=watch).text
    for part in (
        "Drivers identified, by number of windows",
        "Traits of strangers, read from z",
        "Log-likelihood of held-out actions per step [nats]",
        "The learned policy / the demonstrations",
        "Rank correlation of recovered and true driving return",
        "undetermined  by driver: accuracy within 3 points of the ceiling",
        "by driver, accuracy 88.0% (> 87.0%?); 1 seed: undetermined for training",
        "pools of 2, 4, 16.",
        "judging  62 s",
    ):
        assert part in text
    assert "nan" not in text
    missed = report_of(seeds({"none": [one(hits=30)]}), tmp_path, monkeypatch).text
    assert "not supported  unsupervised" in missed


def test_every_number_is_where_its_source_says() -> None:
    for found in (ALL, seeds(THREE, 2), results(none=[one(best=None, driving=[], reading=None)])):
        assert not missing(REPORT.blocks(found), REPORT.numbers(found))


def test_what_was_left_out_is_told_and_nothing_else() -> None:
    every = [identified(size, 60, 10.0, best=(90, 95)) for size in (1, 2, 4, 8, 16)]
    assert left_out(results(none=[one(identified=every)])) == []
    assert left_out(results(none=[one(identified=every[:3])])) == [
        "Too few windows were held out to identify drivers from pools of 8, 16."
    ]
    people = one(best=None, driving=[], reward_ranking=[], reading=None)
    assert len(left_out(results(none=[people]))) == 3
    text = text_of(results(none=[people]))
    assert "There is no exact ceiling." in text
    assert "Recorded drives cannot be replayed" in text
    for title in ("The learned policy", "Rank correlation", "Traits of strangers"):
        assert title not in text


def test_json_holds_every_seed_and_no_nan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    several = THREE | {"none": [one(hits=60), one(hits=70)]}
    report_of(results(**several), tmp_path, monkeypatch)
    content = json.loads((tmp_path / "traits-report.json").read_text("utf-8"))
    assert "NaN" not in (tmp_path / "traits-report.json").read_text("utf-8")
    assert content["pool"] == POOL
    assert list(content["supervisions"]) == ["none", "id", "preference"]
    unsupervised = content["supervisions"]["none"]
    expected = statistics.mean_share([share(60, 100), share(70, 100)])
    assert unsupervised["accuracy"] == expected.as_json()
    assert unsupervised["accuracy"]["high"] == 1.0  # as far as an accuracy reaches
    assert unsupervised["average_kl"]["mean"] == 10.0
    assert unsupervised["paper_kl"] == 435.0
    assert len(unsupervised["seeds"]) == 2
    first = unsupervised["seeds"][0]
    assert first["reward_ranking"][0]["demonstrated"]["f"]["mean"] is None
    assert first["traits"]["eta"]["linear"] == NOT_KNOWN.as_json()
    assert first["driving"][0]["imitated"]["alert_effect"]["mean"] is None
    judged_here = judged_together(REPORT.judge(results(**several)))
    assert content["verdicts"] == [v.as_json() for v in judged_here]
    assert set(REPORT.numbers(results(**several))) == {
        "pool",
        "posterior",
        "supervisions",
        "one_step",
    }


# Figures and the page.


def test_figures_are_pngs() -> None:
    for figure in (embeddings_figure(EMBEDDINGS), accuracy_figure(ALL)):
        assert figure.drawn.startswith(b"\x89PNG\r\n\x1a\n")


def test_any_name_of_a_driver_is_drawn_as_text() -> None:
    one = next(iter(EMBEDDINGS.values()))
    at_once = len(one.names)
    for first in range(0, len(FOREIGN), at_once):
        names = (*FOREIGN[first : first + at_once], *one.names)[:at_once]
        named = replace(one, names=names)
        assert embeddings_figure({"none": named}).drawn.startswith(b"\x89PNG")


def test_figures_show_what_they_are_of(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Any] = {}

    class Saved:
        def savefig(self, content: Any, **settings: Any) -> None:
            content.write(b"figure")

    def curves(*given: Any) -> Saved:
        drawn["accuracy"] = given
        return Saved()

    def panels(given: Any) -> Saved:
        drawn["panels"] = given
        return Saved()

    monkeypatch.setattr(trait_tables, "draw_accuracy", curves)
    monkeypatch.setattr(figures, "draw_embeddings", panels)
    assert accuracy_figure(ALL).drawn == embeddings_figure(EMBEDDINGS).drawn == b"figure"
    windows, lines, ceiling, chance = drawn["accuracy"]
    assert (windows, ceiling, chance) == ([1, 8], [0.9, 0.9], 0.25)
    assert lines["by driver"] == [share(30, 100), share(88, 100)]
    titles = [(panel.title, panel.average_kl) for panel in drawn["panels"]]
    kl = [average_kl(one.means, one.types) for one in EMBEDDINGS.values()]
    assert titles == list(zip(("unsupervised", "by driver", "by preference"), kl, strict=True))
    assert accuracy_figure(results(none=[one(best=None)])).drawn
    assert drawn["accuracy"][2] is None, "an unknown ceiling is not one of 100 %"


def test_the_page_needs_no_other_file_and_is_escaped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = Stopwatch()
    watch.seconds["judging <1>"] = 2.0
    command = "hmi-marl traits evaluate 'a <folder>' --out \"b & c\""
    report_of(ALL, tmp_path, monkeypatch, command_line=command, watch=watch)
    html = (tmp_path / PAGE).read_text("utf-8")
    assert html.startswith("<!doctype html>")
    sources = re.findall(r'src="([^"]{0,40})', html)
    assert len(sources) == 2
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    assert "http" not in html
    assert not re.search(r"<(script|link|iframe)", html)
    for raw in ("marge<b>", "<folder>", "judging <1>", "<5>", "b & c"):
        assert raw not in html
    for escaped in ("marge&lt;b&gt;", "a &lt;folder&gt;", "judging &lt;1&gt;", "&lt;5&gt;"):
        assert escaped in html
    assert "pools of 8; 1 seed(s)" in html
    assert "unsupervised: 20 points above chance</td><td>unsupervised, accuracy 60.0%" in html
    assert "from pools of 2, 4, 16." in html
    assert "not supported" not in html
    report_of(seeds({"none": [one(hits=30)]}), tmp_path, monkeypatch)
    assert "<td class='bad'>not supported</td>" in (tmp_path / PAGE).read_text("utf-8")
