"""Assessments of trait models of several settings and seeds, and their means over seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hmi_marl.experiments.latent_traits.assessment import Assessment, Identified
from hmi_marl.experiments.latent_traits.ceiling import Ceilings
from hmi_marl.experiments.latent_traits.divergence import kl_ratio_of
from hmi_marl.experiments.latent_traits.posterior import PosteriorRow
from hmi_marl.experiments.training_seeds import over_seeds
from hmi_marl.files import json_value
from hmi_marl.paper.printed import AVERAGE_KL
from hmi_marl.reporting import statistics
from hmi_marl.reporting.sources import pointer
from hmi_marl.reporting.statistics import Estimate

AVERAGED = ("naming", "prediction", "likelihood", "driving", "reward_ranking")
"""Fields of assessments of which the average over seeds is reported."""
PROBES = ("linear", "smooth", "network")
"""What reads traits from z; see :class:`TraitR2`."""


@dataclass(frozen=True)
class TraitResults:
    """Assessments of trait models."""

    assessments: Mapping[str, Sequence[Assessment]]
    """By supervision, one for each seed."""
    pool: int
    """Windows that the models pool."""
    one_step: Ceilings | None = None
    """Accuracies of the exact classifier that sees a single observation; None if not known."""
    posterior: PosteriorRow | None = None
    """The exact posterior of judged strangers from as many windows; None if it was not computed."""

    @property
    def first(self) -> Mapping[str, Assessment]:
        """Assessment of the first seed of each setting."""
        return {name: several[0] for name, several in self.assessments.items()}

    @property
    def identified(self) -> list[Identified]:
        """Accuracies of the first model, by windows seen."""
        return next(iter(self.first.values())).identified

    def accuracy(self, setting: str, size: int, of: str = "types") -> Estimate:
        """Average the probe's accuracy on "types" or "preferences"; 1 seed: interval over pools."""
        found = self._probes(setting, size, of)
        return found[0] if len(found) == 1 else statistics.mean_share(found)

    def by_seed(self, setting: str, size: int, of: str = "types") -> Estimate:
        """Average the same over training seeds; without an interval for a single one."""
        return statistics.mean_share(self._probes(setting, size, of))

    def _probes(self, setting: str, size: int, of: str) -> list[Estimate]:
        return [getattr(one.at_pool(size), of).linear_probe for one in self.assessments[setting]]

    def kl_ratio(self, setting: str, other: str, size: int) -> Estimate:
        """Ratio of the average KL of two settings; see :func:`kl_ratio_of`."""
        return kl_ratio_of(self._kl(setting, size), self._kl(other, size))

    def average_kl(self, setting: str, size: int) -> Estimate:
        """Average the KL between driver types over seeds."""
        return statistics.mean_of_same(self._kl(setting, size))

    def _kl(self, setting: str, size: int) -> list[Estimate]:
        return [one.at_pool(size).types.average_kl for one in self.assessments[setting]]

    def trait_r2(self, setting: str, trait: str, probe: str) -> Estimate | None:
        """Average R² of a probe over seeds; 1 seed: interval over strangers; None if not judged."""
        found = self._r2(setting, trait, probe)
        if len(found) < 2:
            return found[0] if found else None
        return statistics.mean_of_same(found)

    def trait_r2_by_seed(self, setting: str, trait: str, probe: str) -> Estimate:
        """Average the same over training seeds; without an interval for a single one."""
        return statistics.mean_of_same(self._r2(setting, trait, probe))

    def _r2(self, setting: str, trait: str, probe: str) -> list[Estimate]:
        readings = [one.reading for one in self.assessments[setting] if one.reading is not None]
        return [getattr(reading.r2[trait], probe) for reading in readings]

    def share_of_exact(self, setting: str, trait: str) -> float | None:
        """Ratio of the network's R² to that of the exact posterior; None if one is not known."""
        found = self.trait_r2(setting, trait, PROBES[-1])
        if self.posterior is None or found is None:
            return None
        return found.mean / self.posterior.traits[trait].r2.mean

    def averaged(self, setting: str, name: str) -> Any:
        """Average a field of the assessments, by its ``name``, over training seeds."""
        return over_seeds([getattr(one, name) for one in self.assessments[setting]])

    def as_json(self) -> dict[str, Any]:
        """JSON content."""
        return {
            "pool": self.pool,
            "one_step": json_value(self.one_step),
            "posterior": json_value(self.posterior),
            "supervisions": {
                name: {
                    "accuracy": self.accuracy(name, self.pool).as_json(),
                    "average_kl": self.average_kl(name, self.pool).as_json(),
                    "paper_kl": AVERAGE_KL.get(name),
                    "by_windows": self._by_windows(name),
                    "r2": self._r2_of_traits(name),
                    **{of: json_value(self.averaged(name, of)) for of in AVERAGED},
                    "seeds": [one.as_json() for one in several],
                }
                for name, several in self.assessments.items()
            },
        }

    def _by_windows(self, setting: str) -> list[dict[str, Any]]:
        """Means over the seeds of a setting, by windows seen."""
        return [
            {
                "windows": row.windows,
                "accuracy": self.accuracy(setting, row.windows).as_json(),
                "average_kl": self.average_kl(setting, row.windows).as_json(),
                "preference_accuracy": self.accuracy(setting, row.windows, "preferences").as_json()
                if row.preferences
                else None,
            }
            for row in self.first[setting].identified
        ]

    def _r2_of_traits(self, setting: str) -> dict[str, Any]:
        """R² of each trait of strangers, means over the seeds of a setting, and the exact ones."""
        reading = self.first[setting].reading
        return {
            trait: {
                **{probe: json_value(self.trait_r2(setting, trait, probe)) for probe in PROBES},
                "share_of_exact": json_value(self.share_of_exact(setting, trait)),
            }
            for trait in (reading.r2 if reading is not None else ())
        }


def sources_of(results: TraitResults, *keys: str | int) -> list[str]:
    """Places of the same numbers of every setting."""
    return [pointer("supervisions", name, *keys) for name in results.assessments]
