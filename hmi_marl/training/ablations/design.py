"""Designs of a self-supervised encoder, without torch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from hmi_marl.checks import Checked

PairLoss = Literal["posteriors", "distance", "cosine", "margin", "balanced-margin"]
"""Loss of two pools of each driver in a batch of drivers.

posteriors: InfoNCE by the likelihood of both posteriors, as trait models learn. distance: InfoNCE
by the squared distance of the means. cosine: InfoNCE by the cosine of the means. Both of these
learn their temperature. margin: the paper's contrastive loss with each driver as a label, a mean
over pairs. balanced-margin: the same with pairs of one driver and other pairs weighted alike.
"""
Pooling = Literal["mean", "maximum", "last-state"]
"""Summary of a window over time; pools are means over their windows.

mean, maximum: of features of some steps each. last-state: the last hidden state of a GRU.
"""
Inputs = Literal[
    "all", "no-average", "no-state", "actions-and-alerts", "state-alone", "no-alert-time"
]
"""Inputs of every step.

no-average: without how likely actions are for the average driver. no-state: without the observed
state, which the average driver reads. actions-and-alerts: without both. state-alone: nothing else.
no-alert-time: as if there had been no alert, also for the average driver.
"""


@dataclass(frozen=True)
class EncoderDesign(Checked):
    """Loss, pooling and inputs of an encoder; by default those of trait models."""

    loss: PairLoss = "posteriors"
    pooling: Pooling = "mean"
    inputs: Inputs = "all"
