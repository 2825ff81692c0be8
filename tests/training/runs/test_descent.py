import math

import pytest
import torch

from hmi_marl.training.runs.descent import LAST_RATE, LONGEST_GRADIENT, Descent


def parabola(x: torch.Tensor) -> torch.Tensor:
    return 0.5 * ((x - 3.0) ** 2).sum()


def test_it_descends() -> None:
    x = torch.nn.Parameter(torch.zeros(2))
    descent = Descent([x], 0.1)
    losses = [descent.step(parabola(x), k / 200) for k in range(200)]
    assert losses[0] == pytest.approx(9.0)
    assert losses[-1] < 0.01


@pytest.mark.parametrize(
    ("progress", "share"), [(0.0, 1.0), (0.5, 0.5 * (1 + LAST_RATE)), (1.0, LAST_RATE)]
)
def test_the_rate_falls_along_half_a_cosine(progress: float, share: float) -> None:
    # The first step of Adam is as long as the rate, whatever the gradient.
    x = torch.nn.Parameter(torch.zeros(1))
    Descent([x], 0.1).step(parabola(x), progress)
    assert x.item() == pytest.approx(0.1 * share, rel=1e-4)


def test_a_long_gradient_is_cut() -> None:
    x = torch.nn.Parameter(torch.zeros(4))
    Descent([x], 0.1).step(1e6 * parabola(x), 0.0)
    assert x.grad is not None
    assert x.grad.norm().item() == pytest.approx(LONGEST_GRADIENT, rel=1e-4)


@pytest.mark.parametrize("factor", [math.nan, math.inf])
def test_divergence_changes_nothing_and_names_the_setting(factor: float) -> None:
    x = torch.nn.Parameter(torch.zeros(1))
    with pytest.raises(FloatingPointError, match=r"not finite with encoder_rate at 0\.1; lower"):
        Descent([x], 0.1, setting="encoder_rate").step(factor * parabola(x), 0.0)
    assert x.item() == 0.0


def test_it_goes_on_from_its_moments() -> None:
    one, other = (torch.nn.Parameter(torch.zeros(2)) for _ in range(2))
    first, second = Descent([one], 0.1, 0.01), Descent([other], 0.1, 0.01)
    for k in range(3):
        first.step(parabola(one), k / 10)
    other.data.copy_(one.data)
    second.load({name: value.clone() for name, value in first.tensors().items()})
    for x, descent in ((one, first), (other, second)):
        descent.step(parabola(x), 0.3)
    torch.testing.assert_close(one, other, rtol=0, atol=0)
