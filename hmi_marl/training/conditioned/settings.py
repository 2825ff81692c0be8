"""Settings of learning the HMI that is conditioned on z; imports no torch."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import PolicyCard, make_card
from hmi_marl.checks import Checked, Count, LearningRate, Seconds, Share, Threads, Weight
from hmi_marl.envs.config import VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import (
    PAPER_DRIVERS,
    Driver,
    TraitDistributions,
    get_driver,
)
from hmi_marl.envs.streams import Seed, Stream, mix

HMI_READS = ("intended_action", "previous_intended_action", "applied_action", "alerted", "time")
"""Observation parts that carry information on attention; lidar and lanes do not."""
_DECIMALS = 3


def strangers(count: int, seed: int) -> tuple[str, ...]:
    """Return drivers with uniformly drawn traits, in the form of the command line."""
    seeds = mix(seed, Stream.TRAITS, np.arange(count, dtype=np.uint64))
    drawn = TraitDistributions().draw(seeds).as_array().round(_DECIMALS)
    return tuple(
        f"stranger-{number}:" + ",".join(f"{value:g}" for value in traits)
        for number, traits in enumerate(drawn)
    )


def with_any_inflation(drivers: tuple[str, ...], inflations: int) -> tuple[Driver, ...]:
    """Repeat each driver with several inflations, so that inflation does not decide the rest."""
    low, high = TraitDistributions().inflation.support
    middles = np.linspace(low, high, 2 * inflations + 1)[1::2]
    found = [get_driver(driver) for driver in drivers]
    return tuple(replace(d, inflation=float(inflation)) for d in found for inflation in middles)


@dataclass(frozen=True)
class ConditionedSettings(Checked):
    """Settings of learning an HMI π(a^A | a^H, s, z) for a population of drivers.

    In each round all drivers take some trips, unknown at the start of the first one; half of them
    with the HMI as it is learned so far, with z as it is inferred under way, the others with AvgHMI
    and random exceptions. Then it learns from all of these trips.

    Raises:
        ValueError, TypeError: a value out of its range, by name.
    """

    driver_policy: str = "trained:driver"
    """Driver policy: a trained run, rule, random, or mixture:NAME,NAME,... of these."""
    traits: str = "trained:traits-self"
    """Trait model whose encoder reads the trips: a run, or trained:NAME."""
    strangers: Count = 384
    """Drivers with uniformly drawn traits."""
    types: Count = 32
    """Teams with each of the four named drivers."""
    candidates: Count = 64
    """Other drivers that the estimator considers for strangers, drawn anew in each round."""
    inflations: Count = 4
    """Inflations tried for each candidate."""
    trips: Count = 2
    """Trips of each driver in a round; what is known of the driver is kept from one to the next."""
    rounds: Count = 24
    """Rounds of driving and learning."""
    updates: Count = 150
    """Gradient steps in each round."""
    batch: Count = 64
    """Trips in each gradient step."""
    learning_rate: LearningRate = 2e-3
    """Learning rate at the start; it falls to a twentieth along half a cosine."""
    weight_decay: Weight = 1e-4
    """Weight decay of AdamW."""
    network: NetworkConfig = field(default_factory=lambda: NetworkConfig((64,), rnn_hidden_dim=64))
    """Network of the HMI."""
    revealing: Share = 0.35
    """Share of steps in which a^H differs from the last applied action, as the exact rules have it.
    """
    seed: Seed = 0
    """Random seed. The same seed gives the same weights (on one machine)."""
    threads: Threads = 1
    """Threads of the world and of the learner. Does not change the trips."""
    checkpoint_every: Seconds = 60.0
    """Least time between checkpoints [s]. Does not change results."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.network.rnn_hidden_dim:
            raise ValueError("network.rnn_hidden_dim is at least 1, but got 0")
        if self.batch > self.trips_per_round:
            raise ValueError(
                f"batch lies in 1 to {self.trips_per_round}, the number of trips in a round, but "
                f"got {self.batch}"
            )

    @property
    def team(self) -> TeamConfig:
        """Configuration of the teams, but for the drivers. No HMI here reads traits."""
        return TeamConfig(ai_sees_attention=False)

    @property
    def trips_per_round(self) -> int:
        """Number of trips in a round."""
        return self.trips * (self.strangers + len(PAPER_DRIVERS) * self.types)

    @property
    def steps(self) -> int:
        """Environment steps to learn from, if no trip ends early."""
        return self.rounds * self.trips_per_round * self.team.horizon

    def card(self, latent: int) -> PolicyCard:
        """Card of the HMI, given the size of z: it reads mean and standard deviation of z."""
        card = make_card(VEHICLE_AI, self.team, self.network, False, 2 * latent)
        return card.reading(HMI_READS)
