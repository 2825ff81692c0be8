"""Compiled loops over drivers: values of alert rules with attention seen, and with it hidden.

All loops take the alert problem of each of G drivers in the same tables:

- ``chance``: p(d_t = 1) by i_t and d_{t-1}, shape (G, 2, 2);
- ``gain``: the expected attention reward of a step by a^A_t, i_t and d_{t-1}, shape (G, 2, 2, 2);
- ``after``: the place of (i_t, c_t) by a^A_t and the place of (i_{t-1}, c_{t-1}), shape (2, N + 1).
  Place 0 is i = 0, place 1 + c is i = 1.

Drivers are shared among threads; each number depends on one driver alone. Importing this module
imports numba.
"""

from __future__ import annotations

from functools import partial

from hmi_marl.envs.worlds.batched.compiler import compiled, inlined, kernel
from hmi_marl.envs.worlds.batched.threads import take

_kernel = partial(kernel, sources=(__file__,))
_FLAT = 1e-13
"""Probability that is dropped: as the length of a piece of an envelope, or as that of a path."""
_TIE = 1e-9
"""Advantage of an alert up to which it counts as none, and the HMI stays silent."""


@_kernel
def follow_seen(progress, chance, gain, after, allowed, room, out):
    """Value of the best rule within each of R sets of rules, attention seen.

    Args:
        progress: see :func:`take`.
        chance, gain, after: see the module.
        allowed: a^A that a set allows in [r, t, d, place]: 1 silence, 2 an alert, 3 both; uint8,
            shape (R, T, 2, N + 1).
        room: shape (G, 2, 2, N + 1).
        out: filled in, shape (G, R).
    """
    sets, horizon, _, places = allowed.shape
    first, last = take(progress, 0, len(out))
    while first < last:
        for g in range(first, last):
            for r in range(sets):
                now, later = room[g, 0], room[g, 1]
                for d in range(2):
                    for p in range(places):
                        later[d, p] = 0.0
                for t in range(horizon - 1, -1, -1):
                    for d in range(2):
                        for p in range(places):
                            choices, best = allowed[r, t, d, p], 0.0
                            for a in range(2):
                                if choices == 2 - a:
                                    continue
                                q = after[a, p]
                                i = min(q, 1)
                                goes = chance[g, i, d]
                                value = gain[g, a, i, d] + _expect(later[0, q], later[1, q], goes)
                                if a == 0 or choices == 2 or value > best:
                                    best = value
                            now[d, p] = best
                    now, later = later, now
                out[g, r] = later[0, 0]
        first, last = take(progress, last - first, len(out))


@inlined
def _expect(attentive, distracted, chance):
    return (1.0 - chance) * attentive + chance * distracted


@compiled
def _sort(lines, count):
    """Sort lines by slope, and equal slopes by value; they are few, and nearly in order."""
    for k in range(1, count):
        u, w, j = lines[k, 0], lines[k, 1], k
        while j > 0:
            steeper = (lines[j - 1, 1] - lines[j - 1, 0]) - (w - u)
            if steeper < 0.0 or (steeper == 0.0 and lines[j - 1, 0] <= u):
                break
            lines[j, 0], lines[j, 1] = lines[j - 1, 0], lines[j - 1, 1]
            j -= 1
        lines[j, 0], lines[j, 1] = u, w


@compiled
def _envelope(lines, count, starts):
    """Keep the lines that are highest somewhere in [0, 1], from left to right; returns how many.

    Args:
        lines: values at 0 and at 1, shape (K, 2), the first ``count`` of them; changed in place.
        count: of lines.
        starts: filled in with where each kept line becomes the highest, shape (K,).
    """
    _sort(lines, count)
    kept = 0
    for k in range(count):
        u, w, start = lines[k, 0], lines[k, 1], 0.0
        while kept > 0:
            steeper = (w - u) - (lines[kept - 1, 1] - lines[kept - 1, 0])
            behind = lines[kept - 1, 0] - u
            if steeper > 0.0:
                start = behind / steeper
            else:
                start = 2.0 if behind > 0.0 else 0.0
            if start > starts[kept - 1] + _FLAT:
                break
            kept -= 1
        if kept == 0:
            start = 0.0
        if start < 1.0 - _FLAT:
            lines[kept, 0], lines[kept, 1], starts[kept] = u, w, start
            kept += 1
    return kept


@compiled
def _add_up(share, silent, silents, begin, shown, showns, turn, into):
    """Write the lines of the sum of two envelopes, with weights 1 - share and share.

    Returns:
        How many there are, or -1 if there is room for fewer.
    """
    j, k, written = 0, 0, 0
    while written < len(into):
        for end in range(2):
            into[written, end] = _expect(silent[j, end], shown[k, end], share)
        written += 1
        next_silent = begin[j + 1] if j + 1 < silents else 2.0
        next_shown = turn[k + 1] if k + 1 < showns else 2.0
        if next_silent > 1.0 and next_shown > 1.0:
            return written
        if next_silent <= next_shown:
            j += 1
        if next_shown <= next_silent:
            k += 1
    return -1


@compiled
def _back_up(share, chance, gain, after, p, lines, counts, room, starts, into):
    """Write the lines of V_t at place p, from those of V_{t+1}, for one driver.

    Args:
        share: of revealing steps.
        chance, gain: of the driver, shapes (2, 2) and (2, 2, 2).
        after: see the module.
        p: place.
        lines, counts: of V_{t+1}, shapes (N + 1, K, 2) and (N + 1,).
        room, starts: shapes (2, K, 2) and (2, K).
        into: filled in, shape (K, 2).

    Returns:
        How many there are, or -1 if K is too few.
    """
    silent, shown = room[0], room[1]
    total = 0
    for a in range(2):
        q = after[a, p]
        i, count = min(q, 1), counts[q]
        if total + count > len(silent):
            return -1
        for d in range(2):
            for k in range(count):
                line = lines[q, k]
                silent[total + k, d] = gain[a, i, d] + _expect(line[0], line[1], chance[i, d])
            # The first line is the highest at b = 0, the last at b = 1.
            revealed = _expect(lines[q, 0, 0], lines[q, count - 1, 1], chance[i, d])
            shown[a, d] = gain[a, i, d] + revealed
        total += count
    silents = _envelope(silent, total, starts[0])
    showns = _envelope(shown, 2, starts[1])
    return _add_up(share, silent, silents, starts[0], shown, showns, starts[1], into)


@_kernel
def solve_hidden(progress, chance, gain, after, revealing, lines, counts, room, starts, out):
    """Value of the best rule on the belief of each driver, as upper envelopes of lines.

    Args:
        progress, chance, gain, after: as of :func:`follow_seen`.
        revealing: share of revealing steps by t, shape (T,).
        lines: the lines of V_t, values at b = 0 and 1, by driver, t modulo S, place and number,
            filled in, shape (G, S, N + 1, K, 2). With S = T + 1 those of all t remain.
        counts: of lines, filled in, shape (G, S, N + 1).
        room, starts: shapes (G, 2, K, 2) and (G, 2, K).
        out: filled in, shape (G,); NaN if K lines are too few.
    """
    slots, places, horizon = lines.shape[1], lines.shape[2], len(revealing)
    first, last = take(progress, 0, len(out))
    while first < last:
        for g in range(first, last):
            for p in range(places):
                counts[g, horizon % slots, p] = 1
                lines[g, horizon % slots, p, 0, 0] = 0.0
                lines[g, horizon % slots, p, 0, 1] = 0.0
            fits = True
            for t in range(horizon - 1, -1, -1):
                now, later = t % slots, (t + 1) % slots
                for p in range(places):
                    if fits:
                        count = _back_up(
                            revealing[t], chance[g], gain[g], after, p, lines[g, later],
                            counts[g, later], room[g], starts[g], lines[g, now, p],
                        )  # fmt: skip
                        counts[g, now, p] = count
                        fits = count > 0
            out[g] = lines[g, 0, 0, 0, 0] if fits else float("nan")
        first, last = take(progress, last - first, len(out))


@inlined
def _highest(lines, count, b):
    best = _expect(lines[0, 0], lines[0, 1], b)
    for k in range(1, count):
        best = max(best, _expect(lines[k, 0], lines[k, 1], b))
    return best


@_kernel
def unfold_rule(progress, chance, gain, after, lines, counts, alerts):
    """Alerts of one driver's best rule on the belief, on every path on which d stays hidden.

    Args:
        progress: see :func:`take`; it counts the steps before which paths begin.
        chance, gain: of the driver, shapes (2, 2) and (2, 2, 2).
        after: see the module.
        lines, counts: of V_t for all t, shapes (T + 1, N + 1, K, 2) and (T + 1, N + 1).
        alerts: a^A in [t, d, place, k, m]: in step t + k, when d_{t-1} and the place were known
            before step t, no step since then has revealed d, and step t + k reveals it (m = 1) or
            does not. Filled in, uint8, shape (T, 2, N + 1, T, 2).
    """
    horizon, _, places, _, _ = alerts.shape
    first, last = take(progress, 0, horizon)
    while first < last:
        for t in range(first, last):
            for d in range(2):
                for start in range(places):
                    b, p = float(d), start
                    for k in range(horizon - t):
                        later, later_counts = lines[t + k + 1], counts[t + k + 1]
                        silent, shown = 0.0, 0.0
                        for a in range(2):
                            q = after[a, p]
                            i, count, sign = min(q, 1), later_counts[q], 2 * a - 1
                            now = _expect(gain[a, i, 0], gain[a, i, 1], b)
                            then = _expect(chance[i, 0], chance[i, 1], b)
                            silent += sign * (now + _highest(later[q], count, then))
                            ends = later[q, 0, 0], later[q, count - 1, 1]
                            shown += sign * (now + _expect(ends[0], ends[1], then))
                        chosen = int(silent > _TIE)
                        alerts[t, d, start, k, 0] = chosen
                        alerts[t, d, start, k, 1] = int(shown > _TIE)
                        p = after[chosen, p]
                        i = min(p, 1)
                        b = _expect(chance[i, 0], chance[i, 1], b)
        first, last = take(progress, last - first, horizon)


@_kernel
def follow_hidden(progress, chance, gain, after, revealing, alerts, room, out):
    """Value of one unfolded rule on the belief for each driver.

    Args:
        progress, chance, gain, after: as of :func:`follow_seen`.
        revealing: as of :func:`solve_hidden`.
        alerts: see :func:`unfold_rule`.
        room: shape (G, T + 1, 2, N + 1).
        out: filled in, shape (G,).
    """
    horizon, _, places, _, _ = alerts.shape
    first, last = take(progress, 0, len(out))
    while first < last:
        for g in range(first, last):
            value = room[g]
            for d in range(2):
                for p in range(places):
                    value[horizon, d, p] = 0.0
            for t in range(horizon - 1, -1, -1):
                for d in range(2):
                    for start in range(places):
                        b, p, left, total = float(d), start, 1.0, 0.0
                        for k in range(horizon - t):
                            share = revealing[t + k]
                            a = alerts[t, d, start, k, 1]
                            q = after[a, p]
                            i = min(q, 1)
                            then = _expect(chance[g, i, 0], chance[g, i, 1], b)
                            shown = _expect(gain[g, a, i, 0], gain[g, a, i, 1], b) + _expect(
                                value[t + k + 1, 0, q], value[t + k + 1, 1, q], then
                            )
                            a = alerts[t, d, start, k, 0]
                            p = after[a, p]
                            i = min(p, 1)
                            silent = _expect(gain[g, a, i, 0], gain[g, a, i, 1], b)
                            b = _expect(chance[g, i, 0], chance[g, i, 1], b)
                            total += left * _expect(silent, shown, share)
                            left *= 1.0 - share
                            if left < _FLAT:
                                break
                        value[t, d, start] = total
            out[g] = value[0, 0, 0]
        first, last = take(progress, last - first, len(out))
