"""Checks of the paper's claims about HMIs and drivers, from the numbers of the experiments.

A check returns a verdict without its text, which the claim gives. Differences between HMIs are
paired by episode, since all cells of the table play the same ones. The thresholds are in
:mod:`hmi_marl.experiments.criteria`, the rule in :mod:`hmi_marl.reporting.verdicts`. Where driver
and HMIs were trained several times, verdicts are over these training seeds; trained once, they are
of the agents that a run has learned.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments import criteria
from hmi_marl.experiments.attentive_drivers import headway_part
from hmi_marl.experiments.hidden_attention import BAYES_AVERAGE
from hmi_marl.experiments.metrics_table.differences import ALL, AVERAGE, NONE, OWN
from hmi_marl.experiments.training_seeds import learned_part
from hmi_marl.paper import audit
from hmi_marl.reporting.statistics import Estimate
from hmi_marl.reporting.verdicts import Part, Verdict

Results = Mapping[str, Mapping[str, Any]]
"""Numbers of each experiment, by its name."""
VARIANTS = {"printed": "η as printed", "eta-1": "η = 1"}
DISTRACTION, SPEED, ATTENTION = "distraction_return", "speed_return", "attention_return"

Check = Callable[[Results], Verdict]
"""Judges a claim, from the numbers of the experiments."""


def undetermined(why: str) -> Check:
    """Make the check of a claim that a simulation cannot decide."""
    return lambda results: Verdict("", reason=why)


def _found(*parts: Part, reason: str = "") -> Verdict:
    return Verdict("", parts, reason)  # the claim gives its text


# The table.


def _differences(results: Results, variant: str) -> Mapping[str, Any]:
    found: Mapping[str, Any] = results["table"]["differences"][variant]
    return found


def _cell(results: Results, variant: str, row: str, driver: str) -> Mapping[str, Any]:
    hmi = driver if row == OWN else row
    cells = results["table"]["tables"][variant]
    return next(c for c in cells if (c["hmi"], c["driver"]) == (hmi, driver))


def _mean(results: Results, variant: str, row: str, metric: str, driver: str = ALL) -> float:
    rows = _differences(results, variant)["rows"]
    found = rows[row] if driver == ALL else _cell(results, variant, row, driver)
    return float(found[metric]["mean"])


def _less(results: Results, variant: str, rows: tuple[str, str], metric: str, who: str) -> Estimate:
    one, other = rows
    found = _differences(results, variant)["between_rows"]
    if f"{one} - {other}" in found:
        return Estimate.from_json(found[f"{one} - {other}"][metric][who])
    return -Estimate.from_json(found[f"{other} - {one}"][metric][who])


def seeds_of(results: Results, experiment: str) -> int:
    """Return the number of training seeds of an experiment."""
    return int(results[experiment].get("training_seeds", 1))


def _paired(
    results: Results, what: str, estimate: Estimate, experiment: str = "table", **more: Any
) -> Part:
    more = {"form": "+z.1f", "paired": True, **more}
    return learned_part(what, estimate, seeds_of(results, experiment), **more)


def gain(
    results: Results,
    variant: str,
    rows: tuple[str, str],
    metric: str,
    who: str = ALL,
) -> Part:
    """State that one row of the table has a higher return than another, paired by episode."""
    rival = abs(_mean(results, variant, rows[1], metric, who))
    by = "all drivers" if who == ALL else who
    what = f"{by}, {rows[0]} less {rows[1]}, {VARIANTS[variant]}:"
    margin = criteria.NO_DIFFERENCE * rival
    estimate = _less(results, variant, rows, metric, who)
    return _paired(results, what, estimate, above=0.0, margin=margin)


def personalised_beats(rival: str, metric: str) -> Check:
    """Compare averages over the drivers, with η as printed and with η = 1."""

    def check(results: Results) -> Verdict:
        told = []
        for variant, title in VARIANTS.items():
            own, other = (_mean(results, variant, row, metric) for row in (OWN, rival))
            text = f"{own:.1f} against {other:.1f} with {title}"
            if metric == SPEED:
                steps, per_step = (
                    _less(results, variant, (OWN, rival), name, ALL)
                    for name in ("steps", "speed_return_per_step")
                )
                text += (
                    f" in episodes that are {steps.shown('+z.2f')} steps longer; per step "
                    f"{per_step.shown('+z.4f')}"
                )
            told.append(text)
        parts = [gain(results, variant, (OWN, rival), metric) for variant in VARIANTS]
        return _found(*parts, reason="; ".join(told))

    return check


def reachable_cells(results: Results) -> Verdict:
    """Check that some alert policy can reach what the paper prints."""
    cells = audit.audit()
    out = [f"{cell.driver} {cell.paper:.0f} ({cell.hmi})" for cell in cells if not cell.reachable]
    reason = f"{len(cells) - len(out)} of {len(cells)} distraction returns can be reached by some "
    reason += f"alert policy with the printed traits in {audit.HORIZONS[0]} to "
    reason += f"{audit.HORIZONS[-1]} steps"
    if out:
        reason += f"; out of reach for every one: {', '.join(out)}"
    parts = [
        Part.exact(
            f"{cell.hmi}, {cell.driver}", cell.paper, above=cell.least, below=cell.most, form=".0f"
        )
        for cell in cells
    ]
    return _found(*parts, reason=reason)


def bart_is_distracted_most(results: Results) -> Verdict:
    """Check that Bart's distraction return is the lowest in every row.

    Without an HMI the learned agents do not matter, so that the exact values decide there.
    """
    parts = []
    for row in (OWN, AVERAGE):
        between = _differences(results, "printed")["between_drivers"][row]
        margin = criteria.NO_DIFFERENCE * abs(_mean(results, "printed", row, DISTRACTION, "bart"))
        for other in (driver for driver in PAPER_DRIVERS if driver != "bart"):
            estimate = Estimate.from_json(between[other]["bart"])
            what = f"{row}: {other} less bart"
            parts.append(_paired(results, what, estimate, above=0.0, margin=margin))
    exact = {
        driver: float(_cell(results, "printed", NONE, driver)["exact_distraction_return"])
        for driver in PAPER_DRIVERS
    }
    parts += [
        Part.exact(f"NoHMI: {other} less bart", exact[other] - exact["bart"], above=0.0)
        for other in PAPER_DRIVERS
        if other != "bart"
    ]
    return _found(*parts, reason="with no HMI Bart and Homer have the same chain")


def average_hmi_helps(results: Results) -> Verdict:
    """Check that AvgHMI gains for Marge and Homer almost what their own HMIs gain over none."""
    parts = []
    for driver in ("marge", "homer"):
        share = Estimate.from_json(_differences(results, "printed")["average_share"][driver])
        what, least = f"{driver}, share of what the own HMI gains:", criteria.AVERAGE_HMI_GAIN
        parts += [
            gain(results, "printed", (AVERAGE, NONE), DISTRACTION, driver),
            gain(results, "printed", (OWN, NONE), DISTRACTION, driver),
            _paired(results, what, share, above=least, form="z.1%"),
        ]
    return _found(*parts)


def average_beats_marges(results: Results) -> Verdict:
    """Check that AvgHMI is better for Marge than her own HMI."""
    return _found(gain(results, "printed", (AVERAGE, OWN), DISTRACTION, "marge"))


def average_costs_speed(results: Results) -> Verdict:
    """Check that AvgHMI lowers the speed returns of Marge and Homer, and Homer's more."""
    more = _differences(results, "printed")["extra_speed_lost"]["homer"]["marge"]
    margin = criteria.NO_DIFFERENCE * abs(_mean(results, "printed", OWN, SPEED, "homer"))
    return _found(
        *(gain(results, "printed", (OWN, AVERAGE), SPEED, who) for who in ("marge", "homer")),
        _paired(results, "homer loses more", Estimate.from_json(more), above=0.0, margin=margin),
    )


def no_help_costs_speed(results: Results) -> Verdict:
    """Check that all but Lisa are slower without an HMI than with their own."""
    slower = [driver for driver in PAPER_DRIVERS if driver != "lisa"]
    lisa = _less(results, "printed", (NONE, OWN), SPEED, "lisa")
    most = criteria.NO_DIFFERENCE * abs(_mean(results, "printed", OWN, SPEED, "lisa"))
    return _found(
        *(gain(results, "printed", (OWN, NONE), SPEED, driver) for driver in slower),
        _paired(results, "lisa, NoHMI less own, η as printed:", lisa, above=-most),
    )


def receptive_drivers(results: Results) -> Verdict:
    """Compare the share of distraction that the own HMI spares, with η as printed."""
    spared = _differences(results, "printed")["spared"]
    asked: dict[str, dict[str, Any]] = {
        driver: {"below": criteria.MOST_SPARED_BY_IGNORING}
        if driver in ("lisa", "bart")
        else {"above": criteria.LEAST_SPARED_BY_HEEDING}
        for driver in PAPER_DRIVERS
    }
    parts = [
        _paired(
            results,
            f"{driver} is spared",
            Estimate.from_json(spared[driver]),
            form="z.1%",
            **ends,
        )
        for driver, ends in asked.items()
    ]
    return _found(*parts)


def personal_rewards(results: Results) -> Verdict:
    """Compare attention returns of own HMIs with the best one for the average driver.

    Attention seen: the learned AvgHMI, which is at the exact optimum. Attention hidden: the exact
    rule for the average driver, since the learned one is a poor rival.
    """
    parts = [
        gain(results, variant, (OWN, AVERAGE), ATTENTION, driver)
        for variant in VARIANTS
        for driver in PAPER_DRIVERS
    ]
    rows = [row for row in results["hidden"]["rows"] if row["driver"] in PAPER_DRIVERS]
    for row in rows:
        estimate = Estimate.from_json(row["own_minus_bayes_average"])
        margin = criteria.NO_DIFFERENCE * abs(row["attention_return"][BAYES_AVERAGE]["mean"])
        what = f"{row['driver']}, attention hidden, learned own less exact rule for the average:"
        parts.append(_paired(results, what, estimate, "hidden", above=0.0, margin=margin))

    def by_driver(of: Callable[[Mapping[str, Any]], float]) -> str:
        return ", ".join(f"{row['driver']} {of(row):+.1f}" for row in rows)

    return _found(
        *parts,
        reason="attention hidden, knowing the driver is worth by exact rules over as many steps "
        f"as were played {by_driver(lambda row: row['exact_worth_same_steps'])} (played: "
        f"{by_driver(lambda row: row['bayes_own_minus_average']['mean'])}); own HMI less learned "
        f"AvgHMI, a poor one: {by_driver(lambda row: row['own_minus_average']['mean'])}",
    )


# Drivers without distraction, and graded alerts.


def caution_keeps_distance(results: Results) -> Verdict:
    """Compare the headways of the cautious and the confident driver after all training."""
    confident, cautious = results["driver"]["rows"][-2:]
    reason = f"median time headway {cautious['time_headway']:.2f} s against "
    reason += f"{confident['time_headway']:.2f} s"
    ratio = Estimate.from_json(cautious["headway_ratio"])
    return _found(headway_part(ratio, seeds_of(results, "driver")), reason=reason)


def graded_alerts(results: Results) -> Verdict:
    """Check that HMIs with several strengths of alert learn the exact optimum."""
    parts = [
        learned_part(
            f"{row['case']['name']} (optimum {row['optimum']:.1f})",
            Estimate.from_json(row["learned"]),
            seeds_of(results, "graded"),
            above=row["least"],
            form="z.1f",
        )
        for row in results["graded"]["rows"]
    ]
    share = f"{100 * criteria.GRADED_OPTIMUM_SHARE:.0f} % of the exact optimum"
    return _found(*parts, reason=f"asked is {share}, or of its gain over silence")
