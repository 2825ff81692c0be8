"""Verdicts on the paper's claims, by numbers that are made up."""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from simulated_reports import POOLS, report

from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.exact.hidden_attention import rule_return, solve_belief
from hmi_marl.experiments.latent_traits.divergence import kl_matrix
from hmi_marl.paper import audit
from hmi_marl.reporting.verdicts import Outcome, Part, Verdict
from hmi_marl.reproduction import trait_findings
from hmi_marl.reproduction.claims import CLAIMS, Claim, claims_json, judge
from hmi_marl.reproduction.trait_findings import earned_by_naming, nearest, share_apart

SUPPORTED, NOT_SUPPORTED, OPEN = Outcome.SUPPORTED, Outcome.NOT_SUPPORTED, Outcome.UNDETERMINED
FOUR = ("lisa", "marge", "bart", "homer")


def by_driver(name: str, value: float, *drivers: str) -> dict[str, float]:
    return {f"{name} {driver}": value for driver in drivers}


@dataclass(frozen=True)
class Turns:
    """Numbers with which a claim is supported, is not, and stays open."""

    claim: str
    """Beginning of the claim."""
    yes: dict[str, float]
    no: dict[str, float] = field(default_factory=dict)
    open: dict[str, float] = field(default_factory=dict)
    about_no: dict[str, Any] = field(default_factory=dict)
    about_yes: dict[str, Any] = field(default_factory=dict)
    about_open: dict[str, Any] = field(default_factory=dict)


ONE_SEED, NOISY, MANY = {"seeds": 1}, {"noise": 10.0}, {"seeds": 40}
KL = {"id KL": 100.0, "preference KL": 100.0, "id accuracy": 0.9}
DISTRACTION, SPEED, ATTENTION = "distraction_return", "speed_return", "attention_return"
HELPED = by_driver(f"AvgHMI - NoHMI {DISTRACTION}", 50.0, "marge", "homer") | by_driver(
    f"own - NoHMI {DISTRACTION}", 50.0, "marge", "homer"
)
SLOWER = by_driver(f"own - NoHMI {SPEED}", 20.0, "marge", "bart", "homer")
COSTS = by_driver(f"own - AvgHMI {SPEED}", 30.0, "marge", "homer")
REWARDED = by_driver(f"own - AvgHMI {ATTENTION}", 50.0, *FOUR)
HIDDEN = {"hidden own - Bayes AvgHMI": 50.0}
BART = {"less bart": 50.0, "NoHMI bart exact": -700.0}
TURNS = (
    Turns(
        "Lisa and Bart most likely ignore",
        {"marge spared": 0.8, "homer spared": 0.8},
        open={"marge spared": 0.5, "homer spared": 0.8},
    ),
    Turns("The binary alert", {"learned": 990.0}, {"learned": 900.0}),
    Turns(
        "A single observation hides",
        {"exact from one": 0.4, "exact from many": 1.0},
        {"exact from one": 0.7, "exact from many": 1.0},
        {"exact from one": 0.4},
    ),
    Turns(
        "Inflating other vehicles",
        {"headway ratio": 1.3},
        {"headway ratio": 1.1},
        {"headway ratio": 1.2},
    ),
    Turns(
        "The ability to distinguish",
        KL | {"preference accuracy": 0.9},
        KL | {"preference accuracy": 0.2},  # with preference labels fewer are named
        KL | {"preference accuracy": 0.9},
        about_open=ONE_SEED,
    ),
    Turns(
        "Supervision by labels",
        {"id accuracy": 0.99, "preference accuracy": 0.99},
        {"id accuracy": 0.99, "preference accuracy": 0.6},
        {"id accuracy": 0.99, "preference accuracy": 0.9},
    ),
    Turns(
        "By driver: often distracted",
        {"id apart": 1.0},
        about_no=MANY,
        open={"id apart": 1.0},
        about_open=ONE_SEED,
    ),
    Turns(
        "By driver: the two often",
        {"id apart": 1.0},
        about_yes=MANY,
        about_no=MANY,
        open={"id apart": 1.0},
        about_open=ONE_SEED,
    ),
    Turns(
        "By preference: the two preferences",
        {"preference apart": 1.0},
        about_no=MANY,
        open={"preference apart": 1.0},
        about_open=ONE_SEED,
    ),
    Turns(
        "By preference: there is more separation",
        {"preference apart": 1.0, "preference bart and homer further": 1.0},
        {"preference apart": 1.0, "preference lisa and marge further": 1.0},
        {"preference apart": 1.0},
    ),
    Turns(
        "That levels of confidence",
        {"exact from many": 0.8},
        {"exact from many": 1.0},
        {"exact from many": 0.95},
    ),
    Turns(
        "Distraction is least",
        {f"own - AvgHMI {DISTRACTION} all": 10.0},
        {f"own - AvgHMI {DISTRACTION} all": -10.0},
        about_open=NOISY,
    ),
    Turns(
        "... and against -470.8",
        {f"own - NoHMI {DISTRACTION} all": 10.0},
        {f"own - NoHMI {DISTRACTION} all": -10.0},
        about_open=NOISY,
    ),
    Turns(
        "Bart is distracted the most",
        BART,
        {"less bart": 50.0},  # with no HMI the exact values are equal
        {"NoHMI bart exact": -700.0},
    ),
    Turns(
        "AvgHMI does a good job",
        HELPED | {"average share": 1.0},
        HELPED | {"average share": 0.8},
        HELPED | {"average share": 0.9},
    ),
    Turns(
        "AvgHMI helps Marge even more",
        {f"own - AvgHMI {DISTRACTION} marge": -50.0},
        {f"own - AvgHMI {DISTRACTION} marge": 50.0},
    ),
    Turns(
        "That comes at a cost",
        COSTS | {"homer loses more speed": 20.0},
        COSTS,
        COSTS | {"homer loses more speed": 20.0},
        about_open={"noise": 30.0},
    ),
    Turns(
        "Drivers are faster with their own HMI",
        {f"own - AvgHMI {SPEED} all": 2.3},
        about_open=NOISY,
    ),
    Turns("... and against 427", {f"own - NoHMI {SPEED} all": 2.3}, about_open=NOISY),
    Turns(
        "Without assistance all but Lisa",
        SLOWER,
        SLOWER | {f"own - NoHMI {SPEED} lisa": 20.0},
        SLOWER | {f"own - NoHMI {SPEED} lisa": 4.5},
    ),
    Turns(
        "Latent structure", {"none accuracy": 0.8}, {"none accuracy": 0.25}, about_no={"seeds": 10}
    ),
    Turns(
        "The representation may be useful",
        {"id apart": 1.0},
        {"id apart": 1.0, "id by preference alone": 1.0},
        {"id apart": 1.0},
        about_yes={"pools": 75},
        about_no={"pools": 150},
        about_open=ONE_SEED,
    ),
    Turns("Personal HMIs produce", REWARDED | HIDDEN, REWARDED, about_open=NOISY),
)


def verdict(turns: Turns, true: dict[str, float], **about: Any) -> Verdict:
    judged = judge(report(true, **about)).claims
    (found,) = (one for one in judged if one.claim.startswith(turns.claim))
    return found


@pytest.mark.parametrize("turns", TURNS, ids=lambda turns: turns.claim)
def test_every_claim_turns_when_the_data_turn(turns: Turns) -> None:
    pytest.importorskip("sklearn")
    for true, about, wanted in (
        (turns.yes, turns.about_yes, SUPPORTED),
        (turns.no, turns.about_no, NOT_SUPPORTED),
        (turns.open, turns.about_open, OPEN),
    ):
        found = verdict(turns, true, **about)
        assert found.outcome is wanted, found.summary
        assert found.basis


def test_every_claim_that_a_run_decides_is_turned() -> None:
    turned = {one.text for one in CLAIMS for turns in TURNS if one.text.startswith(turns.claim)}
    left = [one for one in CLAIMS if one.text not in turned]
    assert len(turned) == len(TURNS)
    assert all(not one.needs for one in left)  # two questions to people, and the audit


def test_what_the_paper_prints_can_be_reached_or_not(monkeypatch: pytest.MonkeyPatch) -> None:
    (claim,) = (one for one in CLAIMS if one.text.startswith("The distraction returns that"))
    found = claim.judge({})
    assert found.outcome is NOT_SUPPORTED
    assert found.reason.startswith("10 of 12")
    assert "lisa -85 (own), bart -123 (own)" in found.reason
    near = [replace(cell, paper=(cell.least + cell.most) / 2) for cell in audit.audit()]
    monkeypatch.setattr(audit, "audit", lambda: near)
    assert claim.judge({}).outcome is SUPPORTED


def test_speed_is_told_per_episode_and_per_step() -> None:
    true = {
        f"own - NoHMI {SPEED} all": 2.3,
        "own - NoHMI steps all": 1.5,
        "own - NoHMI speed_return_per_step all": -0.5,
    }
    (turns,) = (one for one in TURNS if one.claim == "... and against 427")
    found = verdict(turns, true)
    assert found.outcome is SUPPORTED
    assert "in episodes that are +1.50" in found.summary
    assert "per step -0.5" in found.summary


def test_the_exact_rival_is_quoted_before_the_learned_one() -> None:
    true = {"exact worth": 18.0, "hidden Bayes own - AvgHMI": 17.0, "hidden own - AvgHMI": 155.0}
    text = verdict(TURNS[-1], true).reason
    assert text.index("+18.0") < text.index("+17.0") < text.index("a poor one: lisa +155.0")
    assert "by exact rules over as many steps as were played lisa +18.0" in text


# What the verdicts are made of.


def test_a_pool_does_not_pull_its_own_centre() -> None:
    means = np.array([[0.0], [10.0], [4.0], [12.0]])
    # Without itself the centre of the first is 10, of the second 0, of the third 12, of the last 4.
    named = nearest(means, ["a", "a", "b", "b"], ["a", "b"])
    assert named == ["b", "b", "a", "a"]
    apart = share_apart(means, ["a", "a", "b", "b"], ["a"], ["b"])
    assert (apart.mean, apart.count) == (0.0, 4)
    clear = np.array([[0.0], [1.0], [9.0], [10.0]])
    assert share_apart(clear, ["a", "a", "b", "b"], ["a"], ["b"]).mean == 1.0


def test_the_worth_of_naming_drivers_is_that_of_exact_rules() -> None:
    drivers = [name for name in FOUR for _ in range(5)]
    clear = np.repeat(np.arange(4.0), 5)[:, None]
    earned = earned_by_naming(clear, drivers)
    assert {name: each.mean for name, each in earned.items()} == {"lisa": 1.0, "bart": 1.0}
    returns = trait_findings.worth_of_models(0.35)
    rule = solve_belief("average", 7, 100, RewardWeights(), 0.35)
    assert returns["bart"]["average"] == rule_return(rule, "bart", RewardWeights())
    assert returns["bart"]["bart"] - returns["bart"]["average"] == pytest.approx(177.7, abs=0.1)


def test_pools_that_are_all_named_right_leave_doubt_of_a_further_one() -> None:
    drivers = [name for name in FOUR for _ in range(5)]
    (few, many) = (
        earned_by_naming(np.repeat(np.arange(4.0), n)[:, None], [d for d in FOUR for _ in range(n)])
        for n in (5, 500)
    )
    assert few["bart"].error > 10 * many["bart"].error > 0.0
    # By hand: the one more earns any of four shares; with itself it is a sixth of the weight.
    returns = trait_findings.worth_of_models(0.35)["bart"]
    shares = [
        (returns[name] - returns["average"]) / (returns["bart"] - returns["average"])
        for name in FOUR
    ]
    every, weights = np.array([*[1.0] * 5, *shares]), np.array([*[1 / 6] * 5, *[1 / 24] * 4])
    spread = weights @ every**2 - (weights @ every) ** 2
    assert few["bart"].error == pytest.approx(math.sqrt(spread / 6))
    assert set(earned_by_naming(np.zeros((20, 1)), drivers)) == {"lisa", "bart"}


def test_the_use_of_z_is_in_doubt_where_few_pools_were_named() -> None:
    pytest.importorskip("sklearn")
    results = report({"id apart": 1.0})
    for seed in results["traits"]["supervisions"]["id"]["seeds"]:
        each = seed["embedding"]
        keep = [20 * k + j for k in range(4) for j in range(2)]  # two pools of each driver
        each |= {"means": [each["means"][k] for k in keep], "drivers": [*np.repeat(FOUR, 2)]}
    found = trait_findings.representation_is_useful(results)
    assert [part.value for part in found.parts] == [pytest.approx(1.0)] * 2
    assert {part.outcome() for part in found.parts} == {
        OPEN
    }  # was certain, by intervals of no width


def test_nothing_that_z_earns_is_more_than_all_however_few_pools() -> None:
    found = trait_findings.representation_is_useful(report({"id apart": 1.0}))
    for part in found.parts:
        low, high = part.interval(0.9999)
        assert high == 1.0
        assert low < part.value == pytest.approx(1.0)


def test_ratios_of_kl_keep_the_luck_of_the_pools() -> None:
    found = trait_findings.supervision_counts(report(KL))
    ratios = [part for part in found.parts if "KL" in part.what]
    assert [part.luck for part in ratios] == pytest.approx([0.1 * math.sqrt(2)] * 2)
    assert {part.luck_count for part in ratios} == {POOLS}


def test_the_distance_of_pairs_keeps_the_luck_of_the_pools() -> None:
    results = report({})
    (part,) = trait_findings.distraction_separates(results).parts

    def log_ratio(means: Any, types: Any) -> float:
        kl = kl_matrix(means, types)
        lisa, marge, bart, homer = range(4)
        high, low = kl[bart, homer] + kl[homer, bart], kl[lisa, marge] + kl[marge, lisa]
        return math.log(high / low)

    errors = []
    for seed in results["traits"]["supervisions"]["preference"]["seeds"]:
        means = np.array(seed["embedding"]["means"])
        types = np.array([FOUR.index(name) for name in seed["embedding"]["drivers"]])
        left = np.array(
            [log_ratio(np.delete(means, k, axis=0), np.delete(types, k)) for k in range(len(means))]
        )
        variances = [(19 / 20) * 20 * left[types == kind].var() for kind in range(4)]
        errors.append(math.sqrt(sum(variances)))
    assert part.luck == pytest.approx(np.mean(errors), rel=1e-6)
    assert part.luck_count == 80


@pytest.mark.slow
def test_at_most_one_report_in_twenty_claims_an_effect_where_there_is_none() -> None:
    pytest.importorskip("sklearn")
    nothing = {"none accuracy": 0.25, "id accuracy": 0.25, "preference accuracy": 0.25}
    true_ones = ("lisa, NoHMI less own", "lisa is spared", "bart is spared", "the exact classifier")

    def claimed(part: Part, outcome: Outcome) -> bool:
        """Whether an effect is claimed that is not there, or a boundary is said to be left."""
        if part.test == "exact" or part.what.startswith(true_ones):
            return False
        on_the_boundary = part.test == "Wilson" or "optimum" in part.what
        return outcome is SUPPORTED or (on_the_boundary and outcome is NOT_SUPPORTED)

    wrong = 0
    for seed in range(500):
        judged = judge(report(nothing, seed=seed, spread=1.0)).claims
        pairs = [pair for one in judged for pair in zip(one.parts, one.outcomes, strict=True)]
        assert len(pairs) > 60
        wrong += any(claimed(*pair) for pair in pairs)
    assert 0 < wrong <= 0.05 * 500


# The claims.


def test_a_claim_without_its_stages_is_not_judged() -> None:
    def never(results: Any) -> Any:
        raise AssertionError

    found = Claim("somewhere", "something", ("table", "hidden"), never).judge({"table": {}})
    assert found.outcome is OPEN
    assert found.reason == "this run has no stage hidden"


def test_what_only_people_can_tell_is_undetermined() -> None:
    judged = judge({}).claims
    assert [(one.claim, one.where) for one in judged] == [(c.text, c.where) for c in CLAIMS]
    outcomes = {one.outcome for one, claim in zip(judged, CLAIMS, strict=True) if not claim.needs}
    assert outcomes == {OPEN, NOT_SUPPORTED}  # the audit needs no experiment
    content = claims_json(judged)[0]
    assert content["outcome"] == "undetermined"
    assert set(content) >= {"where", "claim", "needs", "outcome", "reason", "parts", "basis"}


def test_criteria_of_experiments_count_among_the_parts_of_the_report() -> None:
    own = Verdict("own", (Part("x", 1.0, "t", "episodes", 9, 1.0, above=0.0),))
    with_own = report() | {"adapt": {"verdicts": [own.as_json()]}}
    alone, together = judge(report()), judge(with_own)
    assert together.experiments["adapt"][0].parts == own.parts
    before, after = (one.claims[1].correction for one in (alone, together))
    assert (after.tested, after.open) == (before.tested + 1, before.open + 1)
    assert together.experiments["adapt"][0].correction == after
