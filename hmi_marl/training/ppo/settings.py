"""Settings of rsl_rl's PPO, in a frozen dataclass that imports no torch."""

from __future__ import annotations

from dataclasses import dataclass

from hmi_marl.checks import check_count, check_positive, check_share


@dataclass(frozen=True)
class PPOSettings:
    """Settings of rsl_rl's PPO.

    Raises:
        ValueError: a number out of its range, by name.
    """

    num_learning_epochs: int = 3
    """Times that each batch is learned from."""
    num_mini_batches: int = 16
    """Parts of a batch, with a gradient step each."""
    gamma: float = 0.98
    """Discount γ per step: 0.98 looks about 10 s ahead."""
    gae_lambda: float = 0.95
    """λ of generalised advantage estimation."""
    learning_rate: float = 1e-3
    """Learning rate at the start."""
    final_learning_rate: float = 2e-5
    """Learning rate at the end; it changes linearly in between."""
    entropy_coef: float = 0.01
    """Coefficient of the policy's entropy bonus at the start."""
    final_entropy_coef: float = 0.0
    """Coefficient of the entropy bonus at the end; it changes linearly in between."""
    clip_param: float = 0.2
    """Clip range of the ratio of an action's new to old probability."""
    max_grad_norm: float = 1.0
    """Largest norm of a gradient."""
    reward_scale: float = 0.1
    """Factor on rewards, so that values are not in the hundreds."""

    def __post_init__(self) -> None:
        for name in ("num_learning_epochs", "num_mini_batches"):
            check_count(name, getattr(self, name))
        for name in ("gamma", "gae_lambda"):
            check_share(name, getattr(self, name))
        for name in (
            "learning_rate",
            "final_learning_rate",
            "clip_param",
            "max_grad_norm",
            "reward_scale",
        ):
            check_positive(name, getattr(self, name))
        for name in ("entropy_coef", "final_entropy_coef"):
            check_positive(name, getattr(self, name), zero=True)
