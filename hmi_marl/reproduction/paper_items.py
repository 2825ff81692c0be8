"""The paper's tables and figures, item by item, with what the reproduction has of each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hmi_marl.envs.drivers import DRIVERS
from hmi_marl.envs.rewards import RewardWeights
from hmi_marl.paper.printed import AVERAGE_KL, DRIVER_TRAITS, REWARDS
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.sources import pointer

ITEMS = "/items"
"""Place of the rows in the report's JSON file."""
HEAD = ("in the paper", "what it shows", "here")


def paper_items(results: Mapping[str, Mapping[str, Any]]) -> Table:
    """List them, with the numbers of the experiments that were run."""
    printed = ", ".join(f"{value:.0f}" for value in AVERAGE_KL.values())
    rows = [
        (
            "Figure 1, schematic of the approach",
            "drivers, embedded by how they drive; no data",
            "no data to make again",
        ),
        (
            "Figure 2, the learning scheme",
            "discriminator, generator and pooling; no data",
            "what the stage of latent traits learns by",
        ),
        (
            "Table of discriminator losses",
            "L1 to L4 and their weights 5, 10 and 1e-4",
            "the losses of the stage of latent traits, with the same weights",
        ),
        (
            "Figure 3, model of distracted driving",
            "the chain of distraction and acceptance; no data",
            "the chain that every number here comes from, and its exact optimum",
        ),
        ("Table of rewards", "eight terms and their coefficients", _rewards()),
        ("Table of driver parameters", "β, α, η and inflation of four drivers", _drivers()),
        (
            "Figure 4, latent embeddings",
            f"three scatter plots; average KL {printed} nats",
            _kl(results),
        ),
        (
            "Table of metrics",
            "speed and distraction returns of four drivers, six HMIs",
            "section on HMIs and drivers, cell by cell" if "table" in results else "not run",
        ),
    ]
    kl = [
        pointer("stages", "traits", "supervisions", name, "average_kl")
        for name in (AVERAGE_KL if "traits" in results else ())
    ]
    return Table("Item by item", HEAD, rows, sources=[ITEMS, *kl])


def _rewards() -> str:
    odd = [name for name, value in REWARDS.items() if getattr(RewardWeights(), name) != value]
    return f"others for {', '.join(odd)}" if odd else "all eight, with the same coefficients"


def _drivers() -> str:
    odd = [name for name, traits in DRIVER_TRAITS.items() if DRIVERS[name].traits != traits]
    return f"others for {', '.join(odd)}" if odd else "the same four"


def _kl(results: Mapping[str, Mapping[str, Any]]) -> str:
    if "traits" not in results:
        return "not run"
    settings = results["traits"]["supervisions"]
    found = ", ".join(f"{settings[name]['average_kl']['mean']:.4g}" for name in AVERAGE_KL)
    return f"section on latent traits; average KL {found} nats"
