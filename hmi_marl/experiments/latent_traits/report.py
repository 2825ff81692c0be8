"""What trait models came to, told: text, JSON, figures and a page.

Settings are told in the paper's order: unsupervised, supervised by who drives, by preference. Each
may have been learned several times, from different seeds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from io import BytesIO
from typing import Any

from matplotlib.figure import Figure

from hmi_marl.experiments.latent_traits.assessment import Assessment
from hmi_marl.experiments.latent_traits.figures import (
    EmbeddingPanel,
    draw_accuracy,
    draw_embeddings,
)
from hmi_marl.experiments.latent_traits.identification import WINDOWS
from hmi_marl.experiments.protocols.report import entry, number, percent
from hmi_marl.reporting import statistics
from hmi_marl.reporting.blocks import Exhibit, Picture, Table, Told, held
from hmi_marl.reporting.page import text_table
from hmi_marl.reporting.statistics import Estimate

Assessments = Mapping[str, Sequence[Assessment]]
"""By supervision, one for each seed."""
TITLES = {"none": "unsupervised", "id": "by driver", "preference": "by preference"}
PAPER_KL = {"none": 435.0, "id": 4940.0, "preference": 2872.0}
"""Under the paper's figure of embeddings."""
IDENTITY_MARGIN, PREFERENCE_MARGIN = 0.03, 0.02
"""How far a supervised accuracy may stay behind the ceiling."""
ABOVE_CHANCE = 0.20
"""By how much the unsupervised accuracy is to beat chance."""
KL_FACTOR = 6.0
"""By which the supervised settings' average KL is to exceed the unsupervised one."""
SMALLEST_KL = 1e-9
"""The unsupervised one counts as at least this much: of vectors that are all one it is 0."""
Rows = list[list[str]]


def over_seeds(values: Sequence[float]) -> Estimate:
    """The mean with its t interval; without one if there is a single seed."""
    if len(values) > 1:
        return statistics.mean(values)
    return Estimate(values[0], values[0], values[0])


def accuracy(assessments: Sequence[Assessment], size: int, of: str = "types") -> Estimate:
    """The linear probe's, over seeds; of a single one with the interval over its pools.

    Args:
        assessments: of one setting.
        size: windows seen.
        of: "types" or "preferences".
    """
    probes = [getattr(one.at_pool(size), of).linear_probe for one in assessments]
    if len(probes) == 1:
        return probes[0]
    found = over_seeds([probe.mean for probe in probes])
    return Estimate(found.mean, max(found.low, 0.0), min(found.high, 1.0))


def average_kl(assessments: Sequence[Assessment], size: int) -> Estimate:
    """Average KL between driver types, over seeds."""
    return over_seeds([one.at_pool(size).types.average_kl for one in assessments])


def verdicts(assessments: Assessments, size: int) -> dict[str, bool]:
    """What is asked of the settings that are there, and whether it holds for their means."""
    told = {}
    first = next(iter(assessments.values()))[0].at_pool(size)
    kl = {name: average_kl(several, size).mean for name, several in assessments.items()}
    if "id" in assessments and first.ceilings is not None:
        short = first.ceilings.identity.mean - accuracy(assessments["id"], size).mean
        told[f"by driver: accuracy within 3 points of the ceiling ({100 * short:.1f})"] = (
            short <= IDENTITY_MARGIN
        )
    if "preference" in assessments and first.preferences and first.ceilings:
        found = accuracy(assessments["preference"], size, "preferences").mean
        short = first.ceilings.preference.mean - found
        told[f"by preference: of preferences within 2 points of it ({100 * short:.1f})"] = (
            short <= PREFERENCE_MARGIN
        )
    if "none" in assessments:
        above = accuracy(assessments["none"], size).mean - first.types.chance
        told[f"unsupervised: 20 points above chance ({100 * above:.1f})"] = above >= ABOVE_CHANCE
        for name in ("id", "preference"):
            if name in kl:
                factor = kl[name] / max(kl["none"], SMALLEST_KL)
                told[f"{TITLES[name]}: KL 6 times the unsupervised one ({factor:.1f})"] = (
                    factor >= KL_FACTOR
                )
    return told


IDENTITY_HEAD = [
    "setting",
    "windows",
    "probe [%]",
    "Bayes [%]",
    "centroid [%]",
    "preference [%]",
    "Bayes [%]",
    "silhouette",
    "Rand",
    "KL",
    "paper",
]


def identity_rows(assessments: Assessments, pool: int) -> Rows:
    """Who drives, by windows seen; the first seed's but for accuracies and KL."""
    rows = []
    for name, several in assessments.items():
        for row in several[0].identified:
            size, preferences = row.windows, row.preferences
            exact = row.ceilings
            rows.append(
                [
                    TITLES[name],
                    str(size),
                    percent(accuracy(several, size)),
                    "-" if exact is None else percent(exact.identity),
                    f"{100 * row.types.nearest_centroid.mean:.1f}",
                    percent(accuracy(several, size, "preferences")) if preferences else "-",
                    percent(exact.preference) if preferences and exact else "-",
                    f"{row.types.silhouette:.2f}",
                    f"{row.types.adjusted_rand:.2f}",
                    f"{average_kl(several, size).mean:.4g}",
                    f"{PAPER_KL[name]:.0f}" if size == pool else "",
                ]
            )
    return rows


TRAITS_HEAD = ["setting", "trait", "R², linear", "R², smooth"]


def trait_rows(assessments: Assessments) -> Rows:
    """What z tells of each trait of unseen drivers, of the first seed."""
    return [
        [TITLES[name], trait, entry(found.linear, "z.2f"), entry(found.smooth, "z.2f")]
        for name, several in assessments.items()
        for trait, found in (several[0].traits or {}).items()
    ]


LIKELIHOOD = {
    "own": "own z",
    "other": "another's z",
    "own_minus_other": "own - another's",
    "exact": "exact",
    "exact_minus_own": "exact - own",
}
LIKELIHOOD_HEAD = ["setting", "driver", *LIKELIHOOD.values()]


def likelihood_rows(assessments: Assessments) -> Rows:
    """Log-likelihood of held-out actions per step, of the first seed."""
    return [
        [
            TITLES[name],
            row.driver,
            *(
                "-" if estimate is None else entry(estimate, "z.3f")
                for estimate in (getattr(row, what) for what in LIKELIHOOD)
            ),
        ]
        for name, several in assessments.items()
        for row in several[0].likelihood
    ]


DRIVING = {
    "speed": "speed [m/s]",
    "headway": "headway [s]",
    "lane_changes": "lane changes/min",
    "repeated": "repeated",
    "alert_effect": "more with alerts",
    "crash_rate": "crashed",
}
DRIVING_HEAD = ["setting", "driver", *DRIVING.values()]


def driving_rows(assessments: Assessments) -> Rows:
    """How the policy drives beside the demonstrations, of the first seed: ours / theirs."""
    return [
        [
            TITLES[name],
            row.driver,
            *(
                " / ".join(
                    number(getattr(one, what).mean, ".3g")
                    for one in (row.imitated, row.demonstrated)
                )
                for what in DRIVING
            ),
        ]
        for name, several in assessments.items()
        for row in several[0].driving
    ]


RANKING_HEAD = [
    "setting",
    "driver",
    "f, demonstrated",
    "g, demonstrated",
    "f, mixture",
    "g, mixture",
]


def ranking_rows(assessments: Assessments) -> Rows:
    """Rank correlation of recovered and true return, of the first seed."""
    return [
        [
            TITLES[name],
            row.driver,
            *(
                entry(correlation, "z.2f")
                for ranks in (row.demonstrated, row.mixture)
                for correlation in (ranks.f, ranks.g)
            ),
        ]
        for name, several in assessments.items()
        for row in several[0].ranking
    ]


def _sections(assessments: Assessments, pool: int) -> list[tuple[str, list[str], Rows]]:
    sections = [
        ("Who drives, from so many windows", IDENTITY_HEAD, identity_rows(assessments, pool)),
        ("Traits of unseen drivers", TRAITS_HEAD, trait_rows(assessments)),
        (
            "Log-likelihood of held-out actions per step [nats]",
            LIKELIHOOD_HEAD,
            likelihood_rows(assessments),
        ),
        (
            "The learned policy / the demonstrations",
            DRIVING_HEAD,
            driving_rows(assessments),
        ),
        (
            "Rank correlation of recovered and true driving return",
            RANKING_HEAD,
            ranking_rows(assessments),
        ),
    ]
    return [section for section in sections if section[2]]


def left_out(assessments: Assessments) -> list[str]:
    """What could not be tried, in a sentence each."""
    first = next(iter(assessments.values()))[0]
    tried = [row.windows for row in first.identified]
    sizes = ", ".join(str(size) for size in WINDOWS if size not in tried)
    return [
        sentence
        for sentence, holds in (
            (f"Too few windows were held out to tell drivers apart by pools of {sizes}.", sizes),
            ("There is no exact ceiling.", first.identified[0].ceilings is None),
            ("Recorded drives cannot be played again, to compare driving.", not first.driving),
        )
        if holds
    ]


def as_text(assessments: Assessments, pool: int, seconds: Mapping[str, float]) -> str:
    """For a terminal."""
    parts = [
        f"{title}\n{text_table(head, rows)}" for title, head, rows in _sections(assessments, pool)
    ]
    parts.append(
        "\n".join(
            f"{'holds ' if holds else 'MISSED'}  {claim}"
            for claim, holds in verdicts(assessments, pool).items()
        )
    )
    parts.append("\n".join(left_out(assessments)))
    if seconds:
        parts.append("\n".join(f"{part}: {spent:.0f} s" for part, spent in seconds.items()))
    return "\n\n".join(part for part in parts if part)


def as_json(assessments: Assessments, pool: int) -> dict[str, Any]:
    """JSON content."""
    return {
        "pool": pool,
        "settings": {
            name: {
                "accuracy": accuracy(several, pool).as_json(),
                "average_kl": average_kl(several, pool).as_json(),
                "paper_kl": PAPER_KL[name],
                "seeds": [one.as_json() for one in several],
            }
            for name, several in assessments.items()
        },
        "verdicts": verdicts(assessments, pool),
    }


def embeddings_figure(assessments: Assessments, pool: int) -> bytes:
    """The paper's figure, of the first seed of each setting. A PNG."""
    panels = []
    for name, several in assessments.items():
        found = several[0].embedding
        kl = several[0].at_pool(pool).types.average_kl
        panels.append(EmbeddingPanel(TITLES[name], found.means, found.types, found.names, kl))
    return _png(draw_embeddings(panels))


def accuracy_figure(assessments: Assessments) -> bytes:
    """Accuracy by windows seen, beside the ceiling and chance. A PNG."""
    first = next(iter(assessments.values()))[0].identified
    windows = [row.windows for row in first]
    curves = {
        TITLES[name]: [accuracy(several, size) for size in windows]
        for name, several in assessments.items()
    }
    exact = [row.ceilings.identity.mean for row in first if row.ceilings is not None]
    return _png(draw_accuracy(windows, curves, exact or None, first[0].types.chance))


def exhibits(assessments: Assessments, pool: int) -> tuple[Exhibit, ...]:
    """What a page shows, without the time that it took."""
    seeds = max(len(several) for several in assessments.values())
    told = (
        f"On held-out windows; pools of {pool}; {seeds} seed(s). Bayes is the exact classifier of "
        "the same windows, which no encoder can beat. Accuracies and KL are means over seeds, the "
        "rest is of the first."
    )
    return (
        Told(" ".join([told, *left_out(assessments)])),
        Picture("embeddings by driver", embeddings_figure(assessments, pool)),
        Picture("accuracy by windows seen", accuracy_figure(assessments)),
        *held(verdicts(assessments, pool)),
        *(Table(*section) for section in _sections(assessments, pool)),
    )


def _png(figure: Figure) -> bytes:
    content = BytesIO()
    figure.savefig(content, format="png", dpi=110)
    return content.getvalue()
