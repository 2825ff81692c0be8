"""Compiled loops over windows and candidates: what a driver intends, and the filter of d.

Every window has the same number G of candidates: M inflations, and for each of them J candidates
that differ in β, α and η, one after the other. Windows are shared among threads; each number
depends on one window and one candidate alone. Importing this module imports numba.
"""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numba.extending import register_jitable

from hmi_marl.envs import compiled_rules  # noqa: F401  (so that the rules can be compiled)
from hmi_marl.envs.worlds.batched.compiler import inlined, kernel
from hmi_marl.envs.worlds.batched.threads import take
from hmi_marl.exact import bayes_filter

_kernel = partial(kernel, sources=(__file__, bayes_filter.__file__))
for rule in (bayes_filter.follow_chain, bayes_filter.weigh):
    register_jitable(error_model="numpy", forceinline=True, _nrt=False)(rule)


@inlined
def _activate(x, size, kind):
    """Apply an activation to the first numbers of ``x``: 0 relu, 1 elu, 2 tanh."""
    if kind == 0:
        for k in range(size):
            x[k] = x[k] if x[k] > 0.0 else 0.0
    elif kind == 1:
        for k in range(size):
            x[k] = x[k] if x[k] > 0.0 else math.expm1(x[k])
    else:
        for k in range(size):
            x[k] = math.tanh(x[k])


@inlined
def _add_row(sums, weight, weights, offset, size):
    """Add ``weight`` times a row of the weights, which begins at ``offset``."""
    row = weights[offset : offset + size]  # so that the loop counts from 0, and becomes a vector's
    for k in range(size):
        sums[k] += weight * row[k]


@inlined
def _chance(logits, size, action, greedy):
    """Probability of one action; of a greedy policy 1 for the first of the likeliest, else 0."""
    best = 0
    for k in range(1, size):
        if logits[k] > logits[best]:
            best = k
    if greedy:
        return 1.0 if action == best else 0.0
    total = 0.0
    for k in range(size):
        total += math.exp(logits[k] - logits[best])
    return math.exp(logits[action] - logits[best]) / total


@_kernel
def intend_windows(
    progress, active, owner, seen, action, shown, columns, sizes, weights, kind, greedy, room, out
):
    """Probability of one action of each window for each candidate, by a feed-forward network.

    Args:
        progress: see :func:`take`.
        active: the windows that take a step, shape (E,); rows of others stay as they are.
        owner: place of each window's candidates, shape (E,).
        seen: what they observe, shape (M, E, D), but for their traits.
        action: the actions, shape (E,).
        shown: traits of the candidates as they are observed, shape (P, G, 4).
        columns: of the observation that the network reads, without traits, shape (C,).
        sizes: units of the inputs, hidden layers and outputs, shape (L + 1,); inputs are the
            columns and then the four traits.
        weights: of each layer in turn, a row for each of its inputs and then its bias.
        kind: of the activation.
        greedy: whether the policy takes the likeliest action.
        room: for three layers of each window, shape (E, 3, largest layer).
        out: filled in, shape (E, G).
    """
    same = shown.shape[1] // seen.shape[0]
    inputs, hidden = len(columns), sizes[1]
    layers = len(sizes) - 1
    first, last = take(progress, 0, len(active))
    while first < last:
        for e in range(first, last):
            if not active[e]:
                continue
            base, x, y = room[e, 0], room[e, 1], room[e, 2]
            for m in range(seen.shape[0]):
                for k in range(hidden):
                    base[k] = weights[sizes[0] * hidden + k]
                for c in range(inputs):
                    value = np.float64(seen[m, e, columns[c]])
                    if value != 0.0:
                        _add_row(base, value, weights, c * hidden, hidden)
                for g in range(m * same, (m + 1) * same):
                    for k in range(hidden):
                        x[k] = base[k]
                    for c in range(4):
                        value = np.float64(shown[owner[e], g, c])
                        _add_row(x, value, weights, (inputs + c) * hidden, hidden)
                    offset = (sizes[0] + 1) * hidden
                    for layer in range(1, layers):
                        rows, width = sizes[layer], sizes[layer + 1]
                        _activate(x, rows, kind)
                        for k in range(width):
                            y[k] = weights[offset + rows * width + k]
                        for c in range(rows):
                            if x[c] != 0.0:
                                _add_row(y, x[c], weights, offset + c * width, width)
                        offset += (rows + 1) * width
                        x, y = y, x
                    out[e, g] = _chance(x, sizes[layers], action[e], greedy)
        first, last = take(progress, last - first, len(active))


@_kernel
def filter_windows(
    progress, active, owner, first_step, kept, helped, follows, seen, traits, chance,
    distracted, attentive, log_evidence,
):  # fmt: skip
    """Take one step of the filter of d for each window and candidate; see :mod:`bayes_filter`.

    Args:
        progress, active, owner: as of :func:`intend_windows`.
        first_step: whether t = 0.
        kept: whether v_t = v_{t-1}, 0 or 1, shape (E,).
        helped: i_t, shape (E,).
        follows: whether v_t = a^H_t, 0 or 1, shape (E,); read only if a^H is seen.
        seen: whether a^H is seen.
        traits: of the candidates, shape (P, G, 4).
        chance: π(v_t), or π(a^H_t) if a^H is seen, shape (E, G).
        distracted, attentive, log_evidence: p(d = 1), p(d = 0) and log p(v up to now), (E, G),
            updated.
    """
    first, last = take(progress, 0, len(active))
    while first < last:
        for e in range(first, last):
            if not active[e]:
                continue
            for g in range(chance.shape[1]):
                numbers = traits[owner[e], g]
                predicted, other = bayes_filter.follow_chain(
                    distracted[e, g], attentive[e, g], helped[e], numbers[0], numbers[1], numbers[2]
                )
                chosen = follows[e] if seen else chance[e, g]
                with_distracted, with_attentive = bayes_filter.weigh(
                    predicted, other, first_step, kept[e], chosen
                )
                evidence = with_distracted + with_attentive
                if evidence > 0.0:
                    distracted[e, g] = with_distracted / evidence
                    attentive[e, g] = with_attentive / evidence
                if seen:
                    evidence *= chance[e, g]
                log_evidence[e, g] += math.log(evidence) if evidence > 0.0 else -np.inf
        first, last = take(progress, last - first, len(active))
