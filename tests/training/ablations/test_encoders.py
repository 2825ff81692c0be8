"""Encoders of other designs: what each reads, and how it sums up a window."""

from typing import get_args

import numpy as np
import pytest
import torch
from demonstrations import LAYOUT, made_up
from trait_models import SMALL

from hmi_marl.agents.learned.situations import ACTIONS, EXTRA
from hmi_marl.agents.learned.trait_model import TraitCard
from hmi_marl.training.ablations.design import EncoderDesign, Inputs
from hmi_marl.training.ablations.encoders import DesignedEncoder
from hmi_marl.training.traits.encoder import ContextEncoder
from hmi_marl.training.traits.episodes import Episodes
from hmi_marl.training.traits.windows import Batch, Windows

CARD = TraitCard(tuple((part.name, part.size) for part in LAYOUT.parts), latent=3, encoder=SMALL)
OBSERVED = made_up([9, 9, 5, 9], driver=[0, 1, 0, 1], names=("lisa", "bart")).observed
WINDOWS = Windows(Episodes.of(OBSERVED), np.full(4, np.nan))
BATCH = WINDOWS.batch(np.array([[0, 2], [1, 3]]))
STATES, BEFORE, SINCE = (
    slice(0, LAYOUT.size),
    slice(LAYOUT.size, LAYOUT.size + ACTIONS),
    slice(LAYOUT.size + ACTIONS, LAYOUT.size + EXTRA),
)
HIDDEN = {
    "all": (),
    "no-average": ("average",),
    "no-state": (),  # which the average driver reads
    "actions-and-alerts": ("states", "average"),
    "state-alone": ("before", "since", "actions", "average"),
    "no-alert-time": ("since",),
}
"""Changes that an encoder of these inputs does not notice."""


def made(**design: str) -> DesignedEncoder:
    """An encoder with weights that make its outputs differ."""
    encoder = DesignedEncoder(CARD, EncoderDesign(**design))
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for weight in encoder.parameters():
            weight.copy_(0.7 * torch.randn(weight.shape, generator=generator))
    return encoder


def sums(encoder: ContextEncoder, batch: Batch = BATCH) -> torch.Tensor:
    with torch.no_grad():
        return encoder.sums(batch)


def changed(what: str, encoder: DesignedEncoder) -> tuple[DesignedEncoder, Batch]:
    """The encoder and the batch with one input changed."""
    x, actions = BATCH.situations.clone(), BATCH.actions
    rng = np.random.default_rng(1)
    if what == "average":
        again = made(**vars(encoder.design))
        with torch.no_grad():
            again.average[-1].bias += torch.arange(5.0)
        return again, BATCH
    if what == "states":
        x[..., STATES] = x[..., STATES] + 1.0
    if what == "before":
        x[..., BEFORE] = x[..., BEFORE].roll(1, -1)
    if what == "since":
        drawn = rng.integers(0, SINCE.stop - SINCE.start, x.shape[:-1])
        x[..., SINCE] = torch.eye(SINCE.stop - SINCE.start)[torch.from_numpy(drawn)]
    if what == "actions":
        actions = torch.where(actions < 0, actions, (actions + 1) % ACTIONS)
    return encoder, Batch(x, actions, BATCH.length)


def test_the_default_design_is_the_context_encoder() -> None:
    encoder, plain = made(), ContextEncoder(CARD)
    plain.load_state_dict(encoder.state_dict())
    torch.testing.assert_close(sums(encoder), sums(plain), rtol=0, atol=0)


@pytest.mark.parametrize("inputs", get_args(Inputs))
def test_an_encoder_notices_its_inputs_and_no_others(inputs: str) -> None:
    encoder = made(inputs=inputs)
    for what in ("states", "before", "since", "actions", "average"):
        same = torch.equal(sums(*changed(what, encoder)), sums(encoder))
        assert same == (what in HIDDEN[inputs]), what


def test_without_the_state_only_the_average_driver_reads_it() -> None:
    encoder = made(inputs="no-state")
    with torch.no_grad():
        encoder.average[0].weight.zero_()
    assert torch.equal(sums(*changed("states", encoder)), sums(encoder))
    whole = made()
    with torch.no_grad():
        whole.average[0].weight.zero_()
    assert not torch.equal(sums(*changed("states", whole)), sums(whole))


def test_the_average_driver_does_not_read_the_time_of_alerts_either() -> None:
    encoder = made(inputs="no-alert-time")
    _, (x, _, _) = changed("since", encoder)
    with torch.no_grad():
        torch.testing.assert_close(encoder.log_average(x), encoder.log_average(BATCH.situations))


def each_of(encoder: ContextEncoder) -> tuple[torch.Tensor, torch.Tensor]:
    """Features of every step of the four windows, and their lengths."""
    x, actions, length = BATCH
    with torch.no_grad():
        read = torch.cat([encoder.behaviour(x, actions), encoder.observed(x)], dim=-1)
        return torch.relu(encoder.step_layer(read)).flatten(0, 1), length.flatten()


def test_the_maximum_is_over_the_steps_before_the_end() -> None:
    encoder = made(pooling="maximum")
    each, length = each_of(encoder)
    with torch.no_grad():
        spans = encoder.spans(each)
    found = sums(encoder).flatten(0, 1)
    for k, steps in enumerate(length):
        torch.testing.assert_close(found[k, :-1] / steps, spans[k, :, :steps].amax(dim=1))


def test_the_last_state_is_that_after_the_last_step() -> None:
    encoder = made(pooling="last-state")
    each, length = each_of(encoder)
    found = sums(encoder).flatten(0, 1)
    for k, steps in enumerate(length):
        with torch.no_grad():
            _, last = encoder.recurrent(each[k : k + 1, :steps])
        torch.testing.assert_close(found[k, :-1] / steps, last[0, 0])


@pytest.mark.parametrize(
    "design", [{"pooling": "last-state"}, {"loss": "cosine"}, {"loss": "distance"}]
)
def test_what_a_design_adds_learns(design: dict[str, str]) -> None:
    encoder = made(**design)
    added = set(dict(encoder.named_parameters())) - set(
        dict(ContextEncoder(CARD).named_parameters())
    )
    learning = {id(weight) for weight in encoder.learning()}
    assert added
    assert {id(w) for n, w in encoder.named_parameters() if n in added} <= learning
