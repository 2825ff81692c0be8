"""Attention that is seen from outside, in place of the chain's draw."""

import numpy as np
import pytest
from standing_world import standing_teams
from step_ways import CONFIGS, VIEWS, WAYS, teams_of

from hmi_marl.agents.catalogue import make_hmi
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.seats import PartnerTurns
from hmi_marl.envs.series import Series
from hmi_marl.envs.step_result import Then

COUNT, STEPS = 12, 25


def played(teams, seen, seed=5):
    """Attention and all that is shown in some steps; ``seen`` gives what is looked at."""
    rng, chance = np.random.default_rng(seed), np.random.default_rng(seed + 1)
    teams.reset(np.arange(COUNT, dtype=np.uint64))
    attention, shown, given, running = [], [], [], []
    for step in range(STEPS):
        actions, alerts = (rng.integers(0, high, COUNT) for high in (5, teams.alerts.choices))
        away = seen(chance, step)
        before, over = teams.applied, teams.over
        result = teams.turn(actions, alerts, views=VIEWS, looking_away=away)
        now = teams.attention
        attention.append([now.distracted, now.accepted, now.counter, now.fatigue])
        shown += [*result.views.values(), *teams.views(VIEWS).values(), result.table, teams.ego.x]
        given.append(np.where(over, -1, -1 if away is None else away))
        running.append(~over)
        keeps = (now.distracted == 1) & (before >= 0)
        expected = np.where(over, before, np.where(keeps, before, actions))
        assert np.array_equal(teams.applied, expected)
    return np.array(attention), shown, np.array(given), np.array(running)


def at_random(rng, step):
    return rng.integers(0, 2, COUNT)


@pytest.mark.parametrize("name", CONFIGS)
def test_d_is_what_was_seen_and_all_else_as_always_in_every_way_to_the_bit(name):
    config = TeamConfig(duration=4.0, scene=Scene(vehicles=(8, 20)), **CONFIGS[name])
    ways = [played(teams_of(kind, config, COUNT), at_random) for kind in WAYS]
    for attention, shown, given, _ in ways:
        seen = given >= 0
        assert seen.mean() > 0.5
        assert np.array_equal(attention[:, 0][seen], given[seen])
        for ours, first in zip(shown, ways[0][1], strict=True):
            assert ours.tobytes() == first.tobytes()
    chain, _, _, running = played(teams_of(WAYS[0], config, COUNT), lambda rng, step: None)
    going = ways[0][3] & running  # crashes differ
    assert going.mean() > 0.3
    for column in (1, 2, 3):  # i, c and f do not depend on d
        assert np.array_equal(ways[0][0][:, column][going], chain[:, column][going])


def test_teams_that_are_not_seen_go_by_chance_to_the_bit():
    config = TeamConfig(driver=["bart", "homer"], duration=4.0)
    half = np.arange(COUNT) % 2 == 0

    def some(rng, step):
        return np.where(half, rng.integers(0, 2, COUNT), -1)

    for kind in WAYS:
        ours, *_ = played(teams_of(kind, config, COUNT), some)
        theirs, *_ = played(teams_of(kind, config, COUNT), lambda rng, step: None)
        assert np.array_equal(ours[:, :, ~half], theirs[:, :, ~half])
        assert not np.array_equal(ours[:, 0, half], theirs[:, 0, half])


@pytest.mark.parametrize(
    ("away", "error", "message"),
    [
        ([0, 2], ValueError, r"looking_away is 0, 1, or -1 by chance, but got 2"),
        ([0, -2], ValueError, r"but got -2"),
        ([0], ValueError, r"looking_away actions have shape \(2,\)"),
        ([0.0, 1.0], TypeError, "looking_away actions are integers"),
    ],
)
def test_what_is_no_attention_is_refused_and_changes_nothing(away, error, message):
    teams = standing_teams(2, driver="bart")
    teams.reset([1, 2])
    before = teams.state()
    with pytest.raises(error, match=message):
        teams.turn([1, 1], [0, 0], looking_away=away)
    assert np.array_equal(teams.state(), before)
    assert teams.steps.tolist() == [0, 0]


def test_series_of_episodes_do_not_go_with_it():
    teams = standing_teams(2, driver="bart")
    seeds = np.array([1, 2], np.uint64)
    teams.reset(seeds)
    with pytest.raises(ValueError, match=r"begin by reset\(\); leave out then="):
        teams.turn(
            [1, 1], [0, 0], then=Then(Series(seeds, teams.config.population)), looking_away=[0, 0]
        )


def test_what_an_ended_team_looks_at_is_not_read():
    teams = standing_teams(2, driver="bart", duration=0.4)
    teams.reset([1, 2])
    teams.world.crash_next[0] = True
    teams.turn([1, 1], [0, 0], looking_away=[1, 1])
    teams.turn([1, 1], [0, 0], looking_away=[9, 0])
    assert teams.attention.distracted.tolist() == [1, 0]


@pytest.mark.parametrize("seat", [DRIVER, VEHICLE_AI])
def test_a_partner_plays_on_with_attention_from_outside(seat):
    teams = standing_teams(2, driver="bart")
    name = "when-distracted" if seat == DRIVER else "always"
    partner = make_hmi(name, teams.config) if seat == DRIVER else _Keeps()
    turns = PartnerTurns(teams, seat, partner)
    teams.reset([1, 2])
    turns.begin(teams.seeds)
    for away in ([1, 0], [0, 1], [1, 1]):
        turns.step([1, 1], looking_away=away)
        assert teams.attention.distracted.tolist() == away
    if seat == DRIVER:
        assert teams.alerted.tolist() == [0, 1]


class _Keeps:
    def reset(self, seeds, which=None):
        pass

    def act(self, observations):
        return np.ones(len(observations), np.int64)
