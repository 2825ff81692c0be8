"""The paper's claims in its own order, each with the function that judges it by our data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from hmi_marl.experiments.metrics_table.differences import AVERAGE, NONE
from hmi_marl.reporting.verdicts import Verdict, judged_together
from hmi_marl.reproduction import findings, trait_findings
from hmi_marl.reproduction.findings import (
    DISTRACTION,
    SPEED,
    Check,
    Results,
    personalised_beats,
    undetermined,
)
from hmi_marl.reproduction.trait_findings import kinds_apart


@dataclass(frozen=True)
class Claim:
    """One claim of the paper."""

    where: str
    """Section of the paper."""
    text: str
    """Quoted, or in short."""
    needs: tuple[str, ...]
    """Experiments with the numbers that decide it."""
    check: Check

    def judge(self, results: Results) -> Verdict:
        """Judge the claim by the numbers of the experiments, if they were run."""
        missing = [name for name in self.needs if name not in results]
        if missing:
            reason = f"this run has no stage {' and '.join(missing)}"
            return Verdict(self.text, reason=reason, where=self.where)
        return replace(self.check(results), claim=self.text, where=self.where)


LOW, HIGH = ("lisa", "marge"), ("bart", "homer")
CONFIDENT, CAUTIOUS = ("lisa", "bart"), ("marge", "homer")
METRICS, DISTINGUISH = "Sec. VIII-C, table of metrics", "Sec. VIII-B, figure of embeddings"

CLAIMS = (
    Claim(
        "Contributions, Sec. VI",
        "The model of distraction and cautiousness is validated by 500 human subjects.",
        (),
        undetermined("a survey of people; nothing here stands for people"),
    ),
    Claim(
        "Sec. IV",
        "Lisa and Bart most likely ignore HMI assistance; Marge and Homer are very receptive.",
        ("table",),
        findings.receptive_drivers,
    ),
    Claim(
        "Sec. IV",
        "The binary alert can be extended to any discrete signal.",
        ("graded",),
        findings.graded_alerts,
    ),
    Claim(
        "Sec. V",
        "A single observation hides who drives; aggregating many makes it possible to tell.",
        ("traits",),
        trait_findings.more_is_clearer,
    ),
    Claim(
        "Sec. VI",
        "Inflating other vehicles models the tendency to leave large headway.",
        ("driver",),
        findings.caution_keeps_distance,
    ),
    Claim(
        "Sec. VIII-A",
        "Labels of preferences can be obtained more easily than labels of drivers.",
        (),
        undetermined("a matter of asking people"),
    ),
    Claim(
        DISTINGUISH,
        "The ability to distinguish drivers is heavily influenced by the level of supervision "
        "(average KL 435 without, 4940 by driver, 2872 by preference).",
        ("traits",),
        trait_findings.supervision_counts,
    ),
    Claim(
        DISTINGUISH,
        "Supervision by labels or by preferences is sufficient to distinguish driver types.",
        ("traits",),
        trait_findings.supervision_suffices,
    ),
    Claim(
        DISTINGUISH,
        "By driver: often distracted drivers are well separated from the others.",
        ("traits",),
        kinds_apart("id", LOW, HIGH, "Lisa and Marge against Bart and Homer"),
    ),
    Claim(
        DISTINGUISH,
        "By driver: the two often distracted ones are highly separated as well.",
        ("traits",),
        kinds_apart("id", ["bart"], ["homer"], "Bart against Homer"),
    ),
    Claim(
        DISTINGUISH,
        "By preference: the two preferences separate into clusters.",
        ("traits",),
        kinds_apart("preference", CONFIDENT, CAUTIOUS, "Lisa and Bart against Marge and Homer"),
    ),
    Claim(
        DISTINGUISH,
        "By preference: there is more separation where drivers are more distracted.",
        ("traits",),
        trait_findings.distraction_separates,
    ),
    Claim(
        DISTINGUISH,
        "That levels of confidence are not distinguished among the attentive is due to the "
        "scenario.",
        ("traits",),
        trait_findings.scenario_hides,
    ),
    Claim(METRICS, "The distraction returns that the table prints.", (), findings.reachable_cells),
    Claim(
        METRICS,
        "Distraction is least with driver-specific HMIs: -101.2 on average against -283.0 with "
        "AvgHMI.",
        ("table",),
        personalised_beats(AVERAGE, DISTRACTION),
    ),
    Claim(
        METRICS,
        "... and against -470.8 with no HMI.",
        ("table",),
        personalised_beats(NONE, DISTRACTION),
    ),
    Claim(
        METRICS,
        "Bart is distracted the most, whatever the HMI.",
        ("table",),
        findings.bart_is_distracted_most,
    ),
    Claim(
        METRICS,
        "AvgHMI does a good job for Marge and Homer, who are receptive.",
        ("table",),
        findings.average_hmi_helps,
    ),
    Claim(
        METRICS,
        "AvgHMI helps Marge even more than her own HMI (-45 against -80).",
        ("table",),
        findings.average_beats_marges,
    ),
    Claim(
        METRICS,
        "That comes at a cost: with AvgHMI Marge and Homer are slower than with their own "
        "(421 against 446, 391 against 458), Homer more so.",
        ("table",),
        findings.average_costs_speed,
    ),
    Claim(
        METRICS,
        "Drivers are faster with their own HMI: 448 on average against 423 with AvgHMI.",
        ("table",),
        personalised_beats(AVERAGE, SPEED),
    ),
    Claim(METRICS, "... and against 427 with no HMI.", ("table",), personalised_beats(NONE, SPEED)),
    Claim(
        METRICS,
        "Without assistance all but Lisa are slower.",
        ("table",),
        findings.no_help_costs_speed,
    ),
    Claim(
        "Conclusions",
        "Latent structure of different drivers can be uncovered.",
        ("traits",),
        trait_findings.structure_uncovered,
    ),
    Claim(
        "Abstract, Conclusions",
        "The representation may be useful for interaction: it allows to deploy policies "
        "appropriate for specific drivers.",
        ("traits",),
        trait_findings.representation_is_useful,
    ),
    Claim(
        "Conclusions",
        "Personal HMIs produce higher rewards than one for an average-case human.",
        ("table", "hidden"),
        findings.personal_rewards,
    ),
)


@dataclass(frozen=True)
class Judged:
    """All verdicts of a reproduction, corrected for the number of their parts together."""

    claims: list[Verdict]
    """Verdicts on the paper's claims."""
    experiments: dict[str, list[Verdict]]
    """Verdicts on the criteria of the experiments, by experiment."""


def judge(results: Results) -> Judged:
    """Judge every claim by the numbers of the experiments, together with their own verdicts."""
    own = {
        name: [Verdict.from_json(each) for each in numbers.get("verdicts", ())]
        for name, numbers in results.items()
    }
    claims = [claim.judge(results) for claim in CLAIMS]
    together = iter(judged_together([*claims, *(v for several in own.values() for v in several)]))
    judged = [next(together) for _ in claims]
    return Judged(judged, {name: [next(together) for _ in each] for name, each in own.items()})


def claims_json(verdicts: Sequence[Verdict]) -> list[dict[str, Any]]:
    """JSON content of the claims' verdicts, with the experiments that each needs."""
    return [
        verdict.as_json() | {"needs": list(claim.needs)}
        for claim, verdict in zip(CLAIMS, verdicts, strict=True)
    ]
