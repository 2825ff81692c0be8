"""Registry of the experiments, in the order in which a whole reproduction runs them.

``hmi-marl reproduce NAME``, its ``--quick``, the pages, the claims and what ships with the package
follow from these entries. The modules are imported only when an experiment is asked for; each can
be imported without torch and without the packages of extras. The first experiment of a whole
reproduction learns the driver policy that others share.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hmi_marl.extras import TRAINING
from hmi_marl.registry import Registry

if TYPE_CHECKING:
    from hmi_marl.experiments.experiment import Experiment


@dataclass(frozen=True)
class Where:
    """Where an experiment is defined, and what it needs."""

    path: str
    """Module and class: "package.module:Class"."""
    needs: tuple[str, ...] = TRAINING
    """Modules of extras, without which it does not begin."""
    in_suite: bool = True
    """Whether a whole reproduction of the paper runs it."""

    def load(self, registered: str) -> type[Experiment[Any]]:
        """Import the class of the experiment ``registered`` under this name.

        Raises:
            ValueError: the class calls it something else; its files would get the wrong name.
        """
        module, _, name = self.path.partition(":")
        kind: type[Experiment[Any]] = getattr(importlib.import_module(module), name)
        if (own := getattr(kind, "name", None)) != registered:
            raise ValueError(f"set {name}.name = {registered!r}, as it is registered, not {own!r}")
        return kind


_TRAITS = (*TRAINING, "pyarrow", "sklearn")
EXPERIMENTS: Registry[Where] = Registry("experiment", "hmi-marl reproduce --help")
EXPERIMENTS.register(
    "table",
    "Learn every policy of the paper's table of HMIs and drivers, and make the table.",
    Where("hmi_marl.experiments.metrics_table.experiment:MetricsTable"),
)
EXPERIMENTS.register(
    "driver",
    "Learn to drive without distraction: speed, crashes and headway by steps.",
    Where("hmi_marl.experiments.attentive_drivers:AttentiveDrivers"),
)
EXPERIMENTS.register(
    "hidden",
    "Compare learned HMIs that do not see attention with Bayes filters, by driver.",
    Where("hmi_marl.experiments.hidden_attention:HiddenAttention"),
)
EXPERIMENTS.register(
    "traits",
    "Learn latent traits in the paper's three settings and self-supervised, and judge them.",
    Where("hmi_marl.experiments.latent_traits.experiment:LatentTraits", _TRAITS),
)
EXPERIMENTS.register(
    "adapt",
    "Learn to infer the driver, and an HMI conditioned on z, for unknown drivers; judge both.",
    Where("hmi_marl.experiments.adaptation.experiment:Adaptation"),
)
EXPERIMENTS.register(
    "identify",
    "Compare who drives, by exact Bayes, with a control driver who reads inflation alone.",
    Where("hmi_marl.experiments.identification.experiment:DriverIdentification"),
)
EXPERIMENTS.register(
    "graded",
    "Compare learned HMIs with the exact optimum: graded alerts, alert fatigue.",
    Where("hmi_marl.experiments.graded_alerts:GradedAlerts"),
)
EXPERIMENTS.register(
    "map",
    "Map exactly when the best alert rule depends on the driver, and what knowing them is worth.",
    Where("hmi_marl.experiments.driver_map.experiment:DriverMap", (), in_suite=False),
)
EXPERIMENTS.register(
    "shifts",
    "Compare what z and exact posteriors say of traits when drivers, HMIs or traits shift.",
    Where("hmi_marl.experiments.trait_shifts.experiment:TraitShifts", ("sklearn",), in_suite=False),
)
EXPERIMENTS.register(
    "ablations",
    "Learn the self-supervised encoder again with one part changed at a time, and compare.",
    Where(
        "hmi_marl.experiments.trait_ablations.experiment:TraitAblations", _TRAITS, in_suite=False
    ),
)
EXPERIMENTS.register(
    "unsupervised",
    "Compare what names drivers without labels, by losses, budget and size of z.",
    Where("hmi_marl.experiments.unsupervised_traits:UnsupervisedTraits", _TRAITS, in_suite=False),
)
EXPERIMENTS.register(
    "protocols",
    "Train by every protocol with equal environment steps and several seeds, and compare them.",
    Where("hmi_marl.experiments.protocols.experiment:ProtocolComparison", in_suite=False),
)
EXPERIMENTS.register(
    "sweep",
    "Train over lists and ranges of any option of train, by protocol and seed.",
    Where("hmi_marl.experiments.sweep.experiment:Sweep", (*TRAINING, "pyarrow"), in_suite=False),
)
