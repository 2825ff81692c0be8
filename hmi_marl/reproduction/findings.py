"""What our data say of the paper's claims: a function each, from the numbers of the stages.

Returns of HMIs and drivers differ where their 95 % intervals do not overlap; other numbers, of
which a run has one for each setting, are held against each other as they are. What counts as enough
is said beside each function and told with each finding.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hmi_marl.envs.drivers import PAPER_DRIVERS
from hmi_marl.experiments.adaptation.hmis import EXPECTED
from hmi_marl.experiments.adaptation.report import GAP_DRIVERS
from hmi_marl.experiments.attentive_drivers import LEAST_HEADWAY_RATIO
from hmi_marl.experiments.graded_alerts import LEAST_SHARE
from hmi_marl.experiments.metrics_table.reproduction import AVERAGE, NONE
from hmi_marl.paper import audit

Results = Mapping[str, Mapping[str, Any]]
"""The numbers of each stage, by its name."""
SETTINGS = {"none": "unsupervised", "id": "by driver", "preference": "by preference"}
VARIANTS = {"printed": "η as printed", "eta-1": "η = 1"}
DISTRACTION, SPEED = "distraction_return", "speed_return"
APART, PARTLY_APART = 0.9, 0.75
"""Of pools that lie next to their own kind, by chance a half."""
IGNORES, HEEDS = 0.1, 0.5
"""Share of distraction that their own HMI spares a driver."""


class Verdict(StrEnum):
    """Whether a claim holds here."""

    SUPPORTED = "supported"
    PARTLY = "partly supported"
    NOT_SUPPORTED = "not supported"
    UNTESTABLE = "cannot be tested here"
    MISSING = "not run"


@dataclass(frozen=True)
class Finding:
    """What our data say."""

    verdict: Verdict
    told: str


Check = Callable[[Results], Finding]


def of_parts(held: Sequence[bool], told: str) -> Finding:
    """Supported if all parts hold, partly if some do."""
    verdict = (
        Verdict.SUPPORTED if all(held) else Verdict.PARTLY if any(held) else Verdict.NOT_SUPPORTED
    )
    return Finding(verdict, told)


def untestable(why: str) -> Check:
    """Of what takes more than a simulation."""
    return lambda results: Finding(Verdict.UNTESTABLE, why)


# The table.


def _cell(results: Results, variant: str, hmi: str, driver: str, metric: str) -> dict[str, Any]:
    cells = results["table"]["tables"][variant]
    found = next(c for c in cells if (c["hmi"], c["driver"]) == (hmi, driver))
    return dict(found[metric])


def _higher(one: Mapping[str, float], other: Mapping[str, float]) -> bool:
    return one["low"] > other["high"]


def _share(part: float, whole: float) -> float:
    """Nothing of nothing is nothing."""
    return part / whole if whole else 0.0


def _average(results: Results, variant: str, hmi: str, metric: str) -> dict[str, Any]:
    averages = results["table"]["averages"][variant]
    found = next(a for a in averages if (a["hmi"], a["metric"]) == (hmi, metric))
    return dict(found["ours"])


def personalised_beats(rival: str, metric: str) -> Check:
    """On the average over the drivers, with η as printed and with η = 1."""

    def check(results: Results) -> Finding:
        held, told = [], []
        for variant, title in VARIANTS.items():
            own, other = (
                _average(results, variant, hmi, metric) for hmi in ("personalised", rival)
            )
            held.append(_higher(own, other))
            told.append(f"{own['mean']:.0f} against {other['mean']:.0f} with {title}")
        return of_parts(held, f"{metric.replace('_', ' ')}s: {'; '.join(told)}")

    return check


def reachable_cells(results: Results) -> Finding:
    """Whether any alert policy at all could reach what the paper prints."""
    cells = audit.audit()
    out = [f"{cell.driver} {cell.paper:.0f} ({cell.hmi})" for cell in cells if not cell.reachable]
    told = f"{len(cells) - len(out)} of {len(cells)} distraction returns can be reached by some "
    told += "alert policy with the printed traits"
    if out:
        told += f"; out of reach for every one: {', '.join(out)}"
    return of_parts([cell.reachable for cell in cells], told)


def bart_is_distracted_most(results: Results) -> Finding:
    """In every row, Bart's distraction return below everybody else's."""
    held, told = [], []
    for hmi in ("own", AVERAGE, NONE):
        found = {
            driver: _cell(results, "printed", driver if hmi == "own" else hmi, driver, DISTRACTION)
            for driver in PAPER_DRIVERS
        }
        others = [found[driver] for driver in PAPER_DRIVERS if driver != "bart"]
        held.append(all(_higher(other, found["bart"]) for other in others))
        homer = found["homer"]["mean"]
        told.append(f"{hmi}: Bart {found['bart']['mean']:.0f}, Homer {homer:.0f}")
    return of_parts(held, "; ".join(told) + " (with no HMI the two have the same chain)")


def average_hmi_helps(results: Results) -> Finding:
    """AvgHMI above NoHMI, and within a tenth of what the own HMI gains, for Marge and Homer."""
    held, told = [], []
    for driver in ("marge", "homer"):
        own, average, none = (
            _cell(results, "printed", hmi, driver, DISTRACTION) for hmi in (driver, AVERAGE, NONE)
        )
        gained = _share(average["mean"] - none["mean"], own["mean"] - none["mean"])
        held.append(_higher(average, none) and gained >= 0.9)
        told.append(
            f"{driver}: {average['mean']:.0f} with AvgHMI, {none['mean']:.0f} without, "
            f"{100 * gained:.0f} % of what the own HMI gains"
        )
    return of_parts(held, "; ".join(told))


def average_beats_marges(results: Results) -> Finding:
    """AvgHMI above Marge's own."""
    average, own = (
        _cell(results, "printed", hmi, "marge", DISTRACTION) for hmi in (AVERAGE, "marge")
    )
    told = f"Marge: {average['mean']:.0f} with AvgHMI, {own['mean']:.0f} with her own"
    return of_parts([_higher(average, own)], told)


def average_costs_speed(results: Results) -> Finding:
    """Speed returns of Marge and Homer lower with AvgHMI than with their own, Homer's more so."""
    held, told, lost = [], [], []
    for driver in ("marge", "homer"):
        own, average = (_cell(results, "printed", hmi, driver, SPEED) for hmi in (driver, AVERAGE))
        held.append(_higher(own, average))
        lost.append((own["low"] - average["high"], own["high"] - average["low"]))
        told.append(f"{driver}: {average['mean']:.0f} with AvgHMI, {own['mean']:.0f} with the own")
    marge, homer = lost
    return of_parts([*held, homer[0] > marge[1]], "; ".join(told))


def no_help_costs_speed(results: Results) -> Finding:
    """Speed lower without an HMI than with the own for Marge, Bart and Homer, and not for Lisa."""
    held, told = [], []
    for driver in PAPER_DRIVERS:
        own, none = (_cell(results, "printed", hmi, driver, SPEED) for hmi in (driver, NONE))
        held.append(_higher(own, none) == (driver != "lisa"))
        told.append(f"{driver} {none['mean'] - own['mean']:+.0f}")
    return of_parts(held, f"without an HMI: {', '.join(told)}")


def receptive_drivers(results: Results) -> Finding:
    """How much of their distraction the own HMI spares each driver, with η as printed."""
    held, told = [], []
    for driver in PAPER_DRIVERS:
        own, none = (_cell(results, "printed", hmi, driver, DISTRACTION) for hmi in (driver, NONE))
        spared = _share(own["mean"] - none["mean"], abs(none["mean"]))
        held.append(spared < IGNORES if driver in ("lisa", "bart") else spared > HEEDS)
        told.append(f"{driver} {100 * spared:.0f} %")
    return of_parts(held, f"the own HMI spares distraction: {', '.join(told)}")


def personal_rewards(results: Results) -> Finding:
    """Attention returns, own HMI above AvgHMI: attention seen (both η), and hidden."""
    held, told = [], []
    for variant, title in VARIANTS.items():
        better = [
            driver
            for driver in PAPER_DRIVERS
            if _higher(
                *(
                    _cell(results, variant, hmi, driver, "attention_return")
                    for hmi in (driver, AVERAGE)
                )
            )
        ]
        held += [driver in better for driver in PAPER_DRIVERS]
        told.append(f"attention seen, {title}: better for {', '.join(better) or 'nobody'}")
    rows = [row for row in results["hidden"]["rows"] if row["driver"] in PAPER_DRIVERS]
    gains = {row["driver"]: row["own_minus_average"] for row in rows}
    held += [gain["low"] > 0 for gain in gains.values()]
    shown = ", ".join(f"{driver} {gain['mean']:+.0f}" for driver, gain in gains.items())
    told.append(f"attention hidden, gain in attention return: {shown}")
    return of_parts(held, "; ".join(told))


def caution_keeps_distance(results: Results) -> Finding:
    """The cautious driver's median headway against the confident one's, after all training."""
    confident, cautious = results["driver"]["rows"][-2:]
    ratio = _share(cautious["time_headway"], confident["time_headway"])
    held = [ratio > 1.0, ratio >= LEAST_HEADWAY_RATIO]
    seconds = f"{cautious['time_headway']:.2f} s against {confident['time_headway']:.2f} s"
    return of_parts(held, f"median time headway {seconds}, {ratio:.2f} times (asked: 1.2)")


# Latent traits.


def _embedding(results: Results, setting: str) -> tuple[NDArray[np.float64], list[str]]:
    found = results["traits"]["supervisions"][setting]["seeds"][0]["embedding"]
    return np.asarray(found["means"], np.float64), list(found["drivers"])


def told_apart(
    means: NDArray[np.float64],
    drivers: Sequence[str],
    one: Sequence[str],
    other: Sequence[str],
) -> float:
    """Share of these drivers' pools whose nearest driver's centre is of their own kind.

    Args:
        means: of z, shape (P, Z).
        drivers: of each pool.
        one, other: the kinds; each counts by half.
    """
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
    """Two kinds of drivers in one setting's embeddings."""

    def check(results: Results) -> Finding:
        share = told_apart(*_embedding(results, setting), one, other)
        told = f"{100 * share:.0f} % of pools lie next to their own kind ({title}; by chance 50 %)"
        return of_parts([share >= PARTLY_APART, share >= APART], told)

    return check


def supervision_counts(results: Results) -> Finding:
    """KL of each supervised setting at least twice the unsupervised one, as in the paper."""
    settings = results["traits"]["supervisions"]
    kl = {name: settings[name]["average_kl"]["mean"] for name in ("none", "id", "preference")}
    numbers = ", ".join(f"{value:.4g}" for value in kl.values())
    ratios = [kl[name] / max(kl["none"], 1e-9) for name in ("id", "preference")]
    told = (
        f"average KL {numbers} nats; supervised {ratios[0]:.1f} and {ratios[1]:.1f} times as much"
    )
    return of_parts([ratio >= 2.0 for ratio in ratios], f"{told} (the paper: 11.4 and 6.6)")


def supervision_suffices(results: Results) -> Finding:
    """Drivers named right in nine of ten pools, with either kind of labels."""
    settings = results["traits"]["supervisions"]
    found = {name: settings[name]["accuracy"]["mean"] for name in ("id", "preference")}
    told = f"drivers named right: {100 * found['id']:.0f} % with labels of drivers, "
    told += f"{100 * found['preference']:.0f} % with labels of preference"
    return of_parts([share >= APART for share in found.values()], told)


def distraction_separates(results: Results) -> Finding:
    """With preference labels: Bart from Homer better than Lisa from Marge, by KL."""
    from hmi_marl.experiments.latent_traits.probes import kl_matrix  # needs the data extra

    means, drivers = _embedding(results, "preference")
    names = list(dict.fromkeys(drivers))
    try:
        kl = kl_matrix(means, np.array([names.index(name) for name in drivers]))
    except ValueError as error:
        return Finding(Verdict.MISSING, f"too few pools: {error}")

    def between(one: str, other: str) -> float:
        a, b = names.index(one), names.index(other)
        return float(kl[a, b] + kl[b, a]) / 2

    high, low = between("bart", "homer"), between("lisa", "marge")
    told = f"KL of Bart and Homer {high:.4g}, of Lisa and Marge {low:.4g} nats"
    return of_parts([high > low], told)


def _pool(results: Results, setting: str) -> dict[str, Any]:
    size = results["traits"]["pool"]
    rows = results["traits"]["supervisions"][setting]["seeds"][0]["identified"]
    return dict(next(row for row in rows if row["windows"] == size))


def scenario_hides(results: Results) -> Finding:
    """Are the two not told apart, and could even the exact classifier not tell?

    It is to be right about all four drivers in 19 of 20 pools, or there is something to be hidden.
    """
    share = told_apart(*_embedding(results, "preference"), ["lisa"], ["marge"])
    told = f"Lisa and Marge: {100 * share:.0f} % of pools lie next to their own, by preference"
    ceilings = _pool(results, "preference")["ceilings"]
    if ceilings is None:
        return Finding(Verdict.MISSING, f"{told}; the exact ceiling is not known")
    exact = ceilings["identity"]["mean"]
    told += f"; the exact classifier names {100 * exact:.0f} % of drivers right, so that the "
    told += f"scenario {'shows' if exact >= 0.95 else 'hides'} who they are"
    return of_parts([share < APART and exact < 0.95], told)


def structure_uncovered(results: Results) -> Finding:
    """Without labels: 20 points above chance, and nine of ten."""
    found = results["traits"]["supervisions"]["none"]["accuracy"]["mean"]
    chance = _pool(results, "none")["types"]["chance"]
    told = f"without labels {100 * found:.0f} % of drivers are named right, by chance "
    return of_parts([found >= chance + 0.2, found >= APART], f"{told}{100 * chance:.0f} %")


def more_is_clearer(results: Results) -> Finding:
    """Accuracy from the most windows above that from one, in every setting."""
    held, told = [], []
    for name, setting in results["traits"]["supervisions"].items():
        rows = setting["seeds"][0]["identified"]
        few, many = rows[0], rows[-1]
        one, several = (row["types"]["linear_probe"] for row in (few, many))
        held.append(several["mean"] > one["mean"])
        told.append(
            f"{SETTINGS[name]} {100 * one['mean']:.0f} % from {few['windows']}, "
            f"{100 * several['mean']:.0f} % from {many['windows']}"
        )
    return of_parts(held, "; ".join(told) + " windows")


def graded_alerts(results: Results) -> Finding:
    """HMIs with several strengths of alert learn the exact optimum."""
    rows = results["graded"]["rows"]
    good = sum(bool(row["holds"]) for row in rows)
    told = (
        f"{good} of {len(rows)} HMIs with graded alerts or fatigue reach {100 * LEAST_SHARE:.0f} "
    )
    told += "% of the exact optimum"
    return of_parts([bool(row["holds"]) for row in rows], told)


def representation_is_useful(results: Results) -> Finding:
    """Half of what knowing the driver is worth earned after three trips, and nine tenths."""
    found = {row["group"]: row["shares"] for row in results["adapt"]["results"]}
    shares = {who: found[who][EXPECTED]["3 trips"]["share"]["mean"] or 0.0 for who in GAP_DRIVERS}
    told = ", ".join(f"{who} {100 * share:.0f} %" for who, share in shares.items())
    held = [share >= least for share in shares.values() for least in (0.5, APART)]
    return of_parts(held, f"of what knowing the driver is worth, earned after three trips: {told}")
