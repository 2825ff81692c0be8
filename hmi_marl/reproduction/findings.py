"""Checks of the paper's claims: a function each, from the numbers of the experiments.

Returns of HMIs and drivers differ where their 95 % intervals do not overlap; other numbers, of
which a run has one for each setting, are compared as they are. The thresholds are in
:mod:`hmi_marl.experiments.criteria`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments import criteria
from hmi_marl.experiments.adaptation.hmis import EXPECTED
from hmi_marl.experiments.metrics_table.paper_table import AVERAGE, NONE
from hmi_marl.paper import audit
from hmi_marl.reporting.verdicts import Outcome, Verdict

Results = Mapping[str, Mapping[str, Any]]
"""Numbers of each experiment, by its name."""
SETTINGS = {
    "none": "unsupervised",
    "id": "by driver",
    "preference": "by preference",
    "self": "self-supervised",
}
VARIANTS = {"printed": "η as printed", "eta-1": "η = 1"}
DISTRACTION, SPEED = "distraction_return", "speed_return"

Check = Callable[[Results], Verdict]
"""Judges a claim, from the numbers of the experiments."""


def of_parts(held: Sequence[bool], reason: str) -> Verdict:
    """Judge a claim of several parts: supported if all hold, partly if some do."""
    return Verdict.of_parts("", held, reason)  # the claim gives its text


def untestable(why: str) -> Check:
    """Make the check of a claim that a simulation cannot decide."""
    return lambda results: Verdict("", Outcome.UNTESTABLE, why)


# The table.


def _cell(results: Results, variant: str, hmi: str, driver: str, metric: str) -> dict[str, Any]:
    cells = results["table"]["tables"][variant]
    found = next(c for c in cells if (c["hmi"], c["driver"]) == (hmi, driver))
    return dict(found[metric])


def _higher(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    return one["low"] > other["high"]


def _share(part: float, whole: float) -> float:
    """Return part / whole, or 0 if the whole is 0."""
    return part / whole if whole else 0.0


def _average(results: Results, variant: str, hmi: str, metric: str) -> dict[str, Any]:
    averages = results["table"]["averages"][variant]
    found = next(a for a in averages if (a["hmi"], a["metric"]) == (hmi, metric))
    return dict(found["ours"])


def personalised_beats(rival: str, metric: str) -> Check:
    """Compare averages over the drivers, with η as printed and with η = 1."""

    def check(results: Results) -> Verdict:
        held, parts = [], []
        for variant, title in VARIANTS.items():
            own, other = (
                _average(results, variant, hmi, metric) for hmi in ("personalised", rival)
            )
            held.append(_higher(own, other))
            parts.append(f"{own['mean']:.0f} against {other['mean']:.0f} with {title}")
        return of_parts(held, f"{metric.replace('_', ' ')}s: {'; '.join(parts)}")

    return check


def reachable_cells(results: Results) -> Verdict:
    """Check that some alert policy can reach what the paper prints."""
    cells = audit.audit()
    out = [f"{cell.driver} {cell.paper:.0f} ({cell.hmi})" for cell in cells if not cell.reachable]
    reason = f"{len(cells) - len(out)} of {len(cells)} distraction returns can be reached by some "
    reason += "alert policy with the printed traits"
    if out:
        reason += f"; out of reach for every one: {', '.join(out)}"
    return of_parts([cell.reachable for cell in cells], reason)


def bart_is_distracted_most(results: Results) -> Verdict:
    """Check that Bart's distraction return is the lowest in every row."""
    held, parts = [], []
    for hmi in ("own", AVERAGE, NONE):
        found = {
            driver: _cell(results, "printed", driver if hmi == "own" else hmi, driver, DISTRACTION)
            for driver in PAPER_DRIVERS
        }
        others = [found[driver] for driver in PAPER_DRIVERS if driver != "bart"]
        held.append(all(_higher(other, found["bart"]) for other in others))
        homer = found["homer"]["mean"]
        parts.append(f"{hmi}: Bart {found['bart']['mean']:.0f}, Homer {homer:.0f}")
    return of_parts(held, "; ".join(parts) + " (with no HMI the two have the same chain)")


def average_hmi_helps(results: Results) -> Verdict:
    """Check that AvgHMI gains for Marge and Homer almost what their own HMIs gain over none."""
    held, parts = [], []
    for driver in ("marge", "homer"):
        own, average, none = (
            _cell(results, "printed", hmi, driver, DISTRACTION) for hmi in (driver, AVERAGE, NONE)
        )
        gained = _share(average["mean"] - none["mean"], own["mean"] - none["mean"])
        held.append(_higher(average, none) and gained >= criteria.AVERAGE_HMI_GAIN)
        parts.append(
            f"{driver}: {average['mean']:.0f} with AvgHMI, {none['mean']:.0f} without, "
            f"{100 * gained:.0f} % of what the own HMI gains"
        )
    return of_parts(held, "; ".join(parts))


def average_beats_marges(results: Results) -> Verdict:
    """Check that AvgHMI is better for Marge than her own HMI."""
    average, own = (
        _cell(results, "printed", hmi, "marge", DISTRACTION) for hmi in (AVERAGE, "marge")
    )
    reason = f"Marge: {average['mean']:.0f} with AvgHMI, {own['mean']:.0f} with her own"
    return of_parts([_higher(average, own)], reason)


def average_costs_speed(results: Results) -> Verdict:
    """Check that AvgHMI lowers the speed returns of Marge and Homer, and Homer's more."""
    held, parts, lost = [], [], []
    for driver in ("marge", "homer"):
        own, average = (_cell(results, "printed", hmi, driver, SPEED) for hmi in (driver, AVERAGE))
        held.append(_higher(own, average))
        lost.append((own["low"] - average["high"], own["high"] - average["low"]))
        parts.append(f"{driver}: {average['mean']:.0f} with AvgHMI, {own['mean']:.0f} with the own")
    marge, homer = lost
    return of_parts([*held, homer[0] > marge[1]], "; ".join(parts))


def no_help_costs_speed(results: Results) -> Verdict:
    """Check that all but Lisa are slower without an HMI than with their own."""
    held, parts = [], []
    for driver in PAPER_DRIVERS:
        own, none = (_cell(results, "printed", hmi, driver, SPEED) for hmi in (driver, NONE))
        held.append(_higher(own, none) == (driver != "lisa"))
        parts.append(f"{driver} {none['mean'] - own['mean']:+.0f}")
    return of_parts(held, f"without an HMI: {', '.join(parts)}")


def receptive_drivers(results: Results) -> Verdict:
    """Compare the share of distraction that the own HMI spares, with η as printed."""
    held, parts = [], []
    for driver in PAPER_DRIVERS:
        own, none = (_cell(results, "printed", hmi, driver, DISTRACTION) for hmi in (driver, NONE))
        spared = _share(own["mean"] - none["mean"], abs(none["mean"]))
        held.append(
            spared < criteria.MOST_SPARED_BY_IGNORING
            if driver in ("lisa", "bart")
            else spared > criteria.LEAST_SPARED_BY_HEEDING
        )
        parts.append(f"{driver} {100 * spared:.0f} %")
    return of_parts(held, f"the own HMI spares distraction: {', '.join(parts)}")


def personal_rewards(results: Results) -> Verdict:
    """Compare attention returns of own HMIs and AvgHMI: attention seen (both η), and hidden."""
    held, parts = [], []
    for variant, title in VARIANTS.items():
        earned = partial(_cell, results, variant, metric="attention_return")
        better = [
            driver
            for driver in PAPER_DRIVERS
            if _higher(earned(driver, driver), earned(AVERAGE, driver))
        ]
        held += [driver in better for driver in PAPER_DRIVERS]
        parts.append(f"attention seen, {title}: better for {', '.join(better) or 'no driver'}")
    rows = [row for row in results["hidden"]["rows"] if row["driver"] in PAPER_DRIVERS]
    gains = {row["driver"]: row["own_minus_average"] for row in rows}
    held += [gain["low"] > 0 for gain in gains.values()]
    shown = ", ".join(f"{driver} {gain['mean']:+.0f}" for driver, gain in gains.items())
    parts.append(f"attention hidden, gain in attention return: {shown}")
    return of_parts(held, "; ".join(parts))


def caution_keeps_distance(results: Results) -> Verdict:
    """Compare the median headways of the cautious and the confident driver after all training."""
    confident, cautious = results["driver"]["rows"][-2:]
    ratio = _share(cautious["time_headway"], confident["time_headway"])
    held = [ratio > 1.0, ratio >= criteria.LEAST_HEADWAY_RATIO]
    reason = f"median time headway {cautious['time_headway']:.2f} s against "
    reason += f"{confident['time_headway']:.2f} s, {ratio:.2f} times "
    return of_parts(held, f"{reason}(asked: {criteria.LEAST_HEADWAY_RATIO})")


# Latent traits.


def _embedding(results: Results, setting: str) -> tuple[NDArray[np.float64], list[str]]:
    found = results["traits"]["supervisions"][setting]["seeds"][0]["embedding"]
    return np.asarray(found["means"], np.float64), list(found["drivers"])


def share_apart(
    means: NDArray[np.float64], drivers: Sequence[str], one: Sequence[str], other: Sequence[str]
) -> float:
    """Share of pools, means (P, Z), nearest to a centre of their kind; either kind counts half."""
    who = np.asarray(drivers)
    names = [*one, *other]
    centres = np.stack([means[who == name].mean(axis=0) for name in names])
    shares = []
    for kind in (one, other):
        own = means[np.isin(who, kind)]
        nearest = np.linalg.norm(own[:, None] - centres, axis=2).argmin(axis=1)
        shares.append(float(np.isin(np.asarray(names)[nearest], kind).mean()))
    return float(np.mean(shares))


def kinds_apart(setting: str, one: Sequence[str], other: Sequence[str], title: str) -> Check:
    """Make the check that two kinds of drivers are apart in one setting's embeddings."""

    def check(results: Results) -> Verdict:
        share = share_apart(*_embedding(results, setting), one, other)
        own = f"{100 * share:.0f} % of pools lie next to their own kind"
        held = [share >= criteria.PARTLY_APART, share >= criteria.APART]
        return of_parts(held, f"{own} ({title}; by chance 50 %)")

    return check


def supervision_counts(results: Results) -> Verdict:
    """Check that KL of each supervised setting is at least twice the unsupervised one."""
    settings = results["traits"]["supervisions"]
    kl = {name: settings[name]["average_kl"]["mean"] for name in ("none", "id", "preference")}
    numbers = ", ".join(f"{value:.4g}" for value in kl.values())
    ratios = [kl[name] / max(kl["none"], criteria.SMALLEST_KL) for name in ("id", "preference")]
    reason = f"average KL {numbers} nats; supervised {ratios[0]:.1f} and {ratios[1]:.1f} times as "
    reason += "much (the paper: 11.4 and 6.6)"
    return of_parts([ratio >= criteria.KL_INFLUENCE for ratio in ratios], reason)


def supervision_suffices(results: Results) -> Verdict:
    """Check that drivers are named right in nine of ten pools, with either kind of labels."""
    settings = results["traits"]["supervisions"]
    found = {name: settings[name]["accuracy"]["mean"] for name in ("id", "preference")}
    reason = f"drivers named right: {100 * found['id']:.0f} % with labels of drivers, "
    reason += f"{100 * found['preference']:.0f} % with labels of preference"
    return of_parts([share >= criteria.APART for share in found.values()], reason)


def distraction_separates(results: Results) -> Verdict:
    """Compare KL of Bart and Homer with that of Lisa and Marge, learned from preferences."""
    from hmi_marl.experiments.latent_traits.probes import kl_matrix  # needs the data extra

    means, drivers = _embedding(results, "preference")
    names = list(dict.fromkeys(drivers))
    try:
        kl = kl_matrix(means, np.array([names.index(name) for name in drivers]))
    except ValueError as error:
        return Verdict("", Outcome.NOT_RUN, f"too few pools: {error}")

    def between(one: str, other: str) -> float:
        a, b = names.index(one), names.index(other)
        return float(kl[a, b] + kl[b, a]) / 2

    high, low = between("bart", "homer"), between("lisa", "marge")
    reason = f"KL of Bart and Homer {high:.4g}, of Lisa and Marge {low:.4g} nats"
    return of_parts([high > low], reason)


def _pool(results: Results, setting: str) -> dict[str, Any]:
    size = results["traits"]["pool"]
    rows = results["traits"]["supervisions"][setting]["seeds"][0]["identified"]
    return dict(next(row for row in rows if row["windows"] == size))


def scenario_hides(results: Results) -> Verdict:
    """Check that Lisa and Marge are not apart, and that the exact classifier cannot name drivers.

    The scenario shows who drives if the classifier names all four drivers in 19 of 20 pools.
    """
    share = share_apart(*_embedding(results, "preference"), ["lisa"], ["marge"])
    reason = f"Lisa and Marge: {100 * share:.0f} % of pools lie next to their own, by preference"
    ceilings = _pool(results, "preference")["ceilings"]
    if ceilings is None:
        return Verdict("", Outcome.NOT_RUN, f"{reason}; the exact ceiling is not known")
    exact = ceilings["identity"]["mean"]
    reason += f"; the exact classifier names {100 * exact:.0f} % of drivers right, so that the "
    reason += f"scenario {'shows' if exact >= criteria.SHOWN_BY_SCENARIO else 'hides'} who they are"
    return of_parts([share < criteria.APART and exact < criteria.SHOWN_BY_SCENARIO], reason)


def structure_uncovered(results: Results) -> Verdict:
    """Check that drivers are named without labels: better than by chance, and in most pools."""
    found = results["traits"]["supervisions"]["none"]["accuracy"]["mean"]
    chance = _pool(results, "none")["types"]["chance"]
    reason = f"without labels {100 * found:.0f} % of drivers are named right, by chance "
    held = [found >= chance + criteria.ABOVE_CHANCE, found >= criteria.APART]
    return of_parts(held, f"{reason}{100 * chance:.0f} %")


def more_is_clearer(results: Results) -> Verdict:
    """Compare the accuracy from the most windows with that from one, in every setting."""
    held, parts = [], []
    for name, setting in results["traits"]["supervisions"].items():
        rows = setting["seeds"][0]["identified"]
        few, many = rows[0], rows[-1]
        one, several = (row["types"]["linear_probe"] for row in (few, many))
        held.append(several["mean"] > one["mean"])
        parts.append(
            f"{SETTINGS[name]} {100 * one['mean']:.0f} % from {few['windows']}, "
            f"{100 * several['mean']:.0f} % from {many['windows']}"
        )
    return of_parts(held, "; ".join(parts) + " windows")


def graded_alerts(results: Results) -> Verdict:
    """Check that HMIs with several strengths of alert learn the exact optimum."""
    rows = results["graded"]["rows"]
    good = sum(bool(row["holds"]) for row in rows)
    reason = (
        f"{good} of {len(rows)} HMIs with graded alerts or fatigue reach "
        f"{100 * criteria.GRADED_OPTIMUM_SHARE:.0f} % of the exact optimum"
    )
    return of_parts([bool(row["holds"]) for row in rows], reason)


def representation_is_useful(results: Results) -> Verdict:
    """Check how much of the worth of knowing the driver is earned after three trips."""
    found = {row["group"]: row["shares"] for row in results["adapt"]["results"]}
    shares = {
        who: found[who][EXPECTED]["3 trips"]["share"]["mean"] or 0.0 for who in criteria.GAP_DRIVERS
    }
    reason = ", ".join(f"{who} {100 * share:.0f} %" for who, share in shares.items())
    asked = criteria.USEFUL, criteria.FULLY_USEFUL
    held = [share >= least for share in shares.values() for least in asked]
    reason = f"of what knowing the driver is worth, earned after three trips: {reason}"
    return of_parts(held, reason)
