"""Thresholds by which experiments and the paper's claims are judged, the same for both.

Shares are in [0, 1]. What the paper prints is in :mod:`hmi_marl.paper.printed`.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

# HMIs that see attention.

EXACT_TOLERANCE = 0.02
"""Largest difference from an exact value that agrees, as a share of it, or within the interval."""
PAPER_TOLERANCE: Mapping[str, float] = MappingProxyType(
    {"distraction_return": 0.1, "speed_return": 0.03}
)
"""Largest difference of ours from a figure that the paper prints that agrees, as a share of that
figure. Speed returns of all policies are close together, so theirs is smaller."""
NO_DIFFERENCE = 0.01
"""Difference between two HMIs that counts as none, as a share of the rival's value: where the whole
interval of a gain is below it, the gain is not supported."""
ETA_1_TOLERANCE = 0.1
"""Largest difference of a figure that the paper prints from what η = 1 would give, as a share."""
OPTIMAL_SHARE = 0.99
"""Share of the gain of the best alerts from which an HMI counts as optimal, and share of steps from
which it counts as following a rule."""
SAME_GAIN = 0.01
"""Difference in share of gain below which two HMIs count as alike."""
AVERAGE_HMI_GAIN = 0.9
"""Least share of what the own HMI gains that AvgHMI gains if it does a good job."""
MOST_SPARED_BY_IGNORING, LEAST_SPARED_BY_HEEDING = 0.1, 0.5
"""Share of distraction spared by the own HMI: at most, by ignoring alerts; at least, by heeding."""

# Drivers without distraction.

LEAST_SPEED_RETURN: Mapping[str, float] = MappingProxyType({"confident": 460.0, "cautious": 405.0})
"""Least speed return per episode, by driver."""
MOST_CRASHES = 0.04
"""Crash rate that the confident driver stays below."""
LEAST_HEADWAY_RATIO = 1.2
"""Least ratio of the cautious driver's median time headway to the confident driver's."""

# HMIs that do not see attention.

BAYES_MARGIN = 0.01
"""Largest shortfall of an HMI as good as the Bayes filter, as a share of the filter's return."""

# When the driver matters.

SAME_RULE = 1e-6
"""Largest loss of return per episode with which a rule counts as optimal: rounding."""
LEAST_WORTH = 1.0
"""Least return per episode that counts as worth knowing the driver for: a tenth of what one
distracted step costs."""

# Graded alerts.

GRADED_OPTIMUM_SHARE = 0.97
"""Least share of the exact optimum that a learned HMI reaches."""

# Latent traits.

IDENTITY_MARGIN, PREFERENCE_MARGIN = 0.03, 0.02
"""Largest gap of supervised accuracies to the exact classifier's: for drivers, for preferences."""
ABOVE_CHANCE = 0.20
"""Least difference of the unsupervised accuracy from chance."""
NAMED_WITHOUT_LABELS = 0.90
"""Least share of pools whose driver is named right from which z counts as naming drivers without
labels."""
KL_FACTOR = 6.0
"""Least ratio of a supervised setting's average KL to the unsupervised one's, as in the paper."""
LINEAR_R2: Mapping[str, float] = MappingProxyType(
    {"beta": 0.85, "alpha": 0.60, "eta": 0.50, "inflation": 0.88}
)
"""Least R² of strangers' traits by a linear probe of the self-supervised z, from pools of eight."""
NETWORK_R2: Mapping[str, float] = MappingProxyType(
    {"beta": 0.90, "alpha": 0.70, "eta": 0.57, "inflation": 0.93}
)
"""The same by a small network."""
KEPT_R2 = 0.9
"""Least share of the R² of a trait that a shift leaves, if the trait is still read."""
NAMED_POOLS, NAMED_WINDOWS = 0.98, 0.88
"""Least share of types named right from one labelled pool each: of pools, and of single windows."""
LOST_BY_Z = 0.02
"""Loss of log-likelihood per step by predicting actions from z in place of the true traits that
counts as none [nats]."""
REWARD_RANKS = 0.7
"""Least rank correlation of the recovered and the true return over good and bad driving."""
KL_INFLUENCE = 2.0
"""Ratio of these from which supervision counts as a heavy influence."""
SMALLEST_KL = 1e-9
"""Least value that the unsupervised average KL counts as: equal vectors have 0 [nats]."""
NO_MORE_ACCURATE = 0.05
"""Gain in accuracy that counts as none: where the whole interval is below it, labels add nothing.
"""
APART = 0.9
"""Share of pools next to their own kind, and of drivers named, from which kinds count as apart. By
chance it is one half for two kinds."""
HIDES = 0.5
"""Accuracy of the exact classifier of one of four drivers below which an observation hides who
drives."""
SHOWN_BY_SCENARIO = 0.95
"""Accuracy of the exact classifier from which a scenario shows who drives."""

# Unknown drivers.

GAP_DRIVERS = ("lisa", "bart")
"""Drivers of the paper for whom knowing them is worth most."""
GAP_CLOSED: Mapping[str, float] = MappingProxyType({"1 trip": 0.90, "3 trips": 0.97})
"""Least share of the gap between AvgHMI and an HMI that knows the driver that is closed."""
POPULATION_GAP_CLOSED: Mapping[str, float] = MappingProxyType({"1 trip": 0.90, "3 trips": 0.90})
"""The same for the continuous population."""
CONDITIONED_GAP_CLOSED: Mapping[str, float] = MappingProxyType({"1 trip": 0.80, "3 trips": 0.90})
"""The same for the continuous population, by the HMI conditioned on z."""
FIRST_SECONDS_LOSS = 3.0
"""Loss of attention return against AvgHMI in the first 5 s that counts as none: a tenth of what one
accepted alert earns."""
MOST_REGRET = 0.10
"""Largest regret 20 s after a change of driver, as a share of what the knowing HMI earns."""
USEFUL = 0.5
"""Share of the exact worth of knowing the driver from which a representation counts as useful."""

# Protocols.

MORE_CRASHES = 0.05
"""Minimum crash-rate increase over the two-stage driver reported as a difference."""
SIGNALLING_GAIN = 0.75
"""Least share of the way from the two-stage HMI to the optimum that sees attention that learning
together closes, if drivers learn to signal."""
SWEEP_END = 0.1
"""Largest difference of the smallest λ from the free driver, and of the largest from the two-stage
one, as a share of the attention return between both."""
