"""Losses of two pools of each driver, against values by hand."""

import pytest
import torch

from hmi_marl.training.ablations.losses import FIRST_SHARPNESS, MARGIN, PairLosses
from hmi_marl.training.traits.losses import contrastive_loss, same_driver_loss


def posteriors(drivers: int = 5, size: int = 3) -> list[torch.Tensor]:
    """Means and log variances of one pool and of the other."""
    generator = torch.Generator().manual_seed(0)
    return [torch.randn(drivers, size, generator=generator) for _ in range(4)]


def test_by_default_it_is_the_loss_of_trait_models() -> None:
    of = posteriors()
    assert PairLosses("posteriors")(*of) == same_driver_loss(*of)
    assert not list(PairLosses("posteriors").parameters())


def test_distance_is_that_loss_with_one_variance_for_all() -> None:
    loss, (mean, _, other, _) = PairLosses("distance"), posteriors()
    sharpness = FIRST_SHARPNESS["distance"]
    equal = torch.full_like(mean, 0.5 / sharpness).log()  # of two pools, 1 / sharpness
    found = loss(mean, torch.zeros_like(mean), other, torch.zeros_like(mean))
    torch.testing.assert_close(found, same_driver_loss(mean, equal, other, equal))


def test_cosine_does_not_depend_on_lengths() -> None:
    loss, (mean, scale, other, _) = PairLosses("cosine"), posteriors()
    longer = mean * scale[:, :1].exp()
    torch.testing.assert_close(loss(longer, scale, other, scale), loss(mean, scale, other, scale))
    scores = FIRST_SHARPNESS["cosine"] * torch.nn.functional.cosine_similarity(
        mean[:, None], other[None], dim=2
    )
    of_one, of_other = (torch.log_softmax(scores, dim=k).diagonal().mean() for k in (1, 0))
    torch.testing.assert_close(loss(mean, scale, other, scale), -(of_one + of_other) / 2)


def test_the_temperature_learns() -> None:
    for name in FIRST_SHARPNESS:
        loss = PairLosses(name)
        loss(*posteriors()).backward()
        assert loss.log_sharpness.grad != 0


def test_margin_is_the_papers_loss_with_drivers_as_labels() -> None:
    mean, scale, other, _ = posteriors()
    wanted = contrastive_loss(torch.cat([mean, other]), torch.tensor([0, 1, 2, 3, 4] * 2), MARGIN)
    assert PairLosses("margin")(mean, scale, other, scale) == wanted


def test_the_balanced_margin_by_hand() -> None:
    mean = torch.tensor([[0.0, 0.0], [3.0, 0.0]])
    other = torch.tensor([[0.0, 1.0], [1.0, 0.0]])
    # Of one driver: 1 and 4. Others: 1 apart, and sqrt(10), which is beyond the margin.
    found = PairLosses("balanced-margin")(mean, mean, other, other)
    assert found.item() == pytest.approx(2.5 + (MARGIN - 1.0) ** 2 / 2)


def test_equal_vectors_have_finite_gradients() -> None:
    for name in ("margin", "balanced-margin", "cosine"):
        mean = torch.ones(3, 2, requires_grad=True)
        PairLosses(name)(mean, mean, mean, mean).backward()
        assert torch.isfinite(mean.grad).all()
