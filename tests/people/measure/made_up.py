"""Steps of made-up persons by the chain, without a road, for statistics."""

import numpy as np

from hmi_marl.envs.attention import distraction_probability, next_acceptance


def walk(beta, alpha, eta, trips, rng, steps=100, rate=0.0943, window=7, change=None):
    """d_t and alerts of trips by the chain; ``change(p_away, age, away, counter)`` may alter it."""
    away, alerts = np.zeros((trips, steps), int), (rng.random((trips, steps)) < rate).astype(int)
    before, accepted, counter, age = np.zeros((4, trips), int)
    for t in range(steps):
        accepted, counter = next_acceptance(accepted, counter, alerts[:, t], window)
        age = age + 1
        chance = distraction_probability(before, accepted, beta, alpha, eta)
        if change is not None:
            chance = change(chance, age, before, accepted, counter)
        now = (rng.random(trips) < chance).astype(int)
        age, before = np.where(now != before, 0, age), now
        away[:, t] = now
    return list(zip(away, alerts, strict=True))
