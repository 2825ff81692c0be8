import itertools
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from scripted_drivers import RevealingDriver
from standing_world import CrashingWorld, StandingWorld

from hmi_marl.agents import BeliefAlert, make_driver_policy, make_hmi
from hmi_marl.agents.rollout import begin, play
from hmi_marl.envs.alerts import Fatigue
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver
from hmi_marl.envs.scene import Scene
from hmi_marl.exact.hidden_attention import filter_outcomes, solve_belief
from hmi_marl.exact.signalling import entropy
from hmi_marl.experiments.episodes import play_episodes
from hmi_marl.experiments.signalling import (
    SITUATIONS,
    SignalCounter,
    Signals,
    measure_signalling,
    revealing_share,
    signalling_tables,
)
from hmi_marl.reporting.blocks import as_text

SHORT = TeamConfig(driver="bart", duration=2.0, ai_sees_attention=False)
CROWDED = TeamConfig(
    driver=["lisa", "bart"], duration=4.0, ai_sees_attention=False, scene=Scene(vehicles=20)
)
SUMS = [field.name for field in fields(Signals)]


def counted(config, driver, hmi, seeds, world=None):
    """Signals of a driver policy with an HMI by name, in cars that never move by default."""
    seeds = np.array(seeds, np.uint64)
    ai, counter = make_hmi(hmi, config), SignalCounter()
    world = world or StandingWorld(config.scene, len(seeds))
    play(begin(config, driver, ai, seeds, world), driver, ai, [counter])
    return counter


def assert_same(one, other):
    np.testing.assert_array_equal(one.steps, other.steps)
    np.testing.assert_array_equal(one.revealing, other.revealing)
    for name in SUMS[2:]:
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-12)


@pytest.mark.parametrize("hmi", ["never", "random:0.3", "belief"])
def test_a_driver_who_keeps_the_last_applied_action_reveals_nothing(hmi):
    counter = counted(SHORT, RevealingDriver(SHORT, 0.0), hmi, range(20))
    total, parts = counter.signals()
    assert total.steps.tolist() == [9] * 20, "all but the first"
    assert (total.entropy > 1.0).all(), "d is not known"
    for signals in (total, *(each for part in parts.values() for each in part.values())):
        assert not signals.revealing.any()
        assert not signals.information.any()


def by_enumeration(config, driver_policy, hmi, seed):
    """Sums of one episode by hand: beliefs by enumerating every hidden sequence."""
    driver = config.only_driver
    teams = begin(
        config, driver_policy, hmi, np.array([seed], np.uint64), StandingWorld(config.scene, 1)
    )
    helped, last, intended, applied = [], [], [], []
    sums = dict.fromkeys(SUMS, 0.0)

    def belief(upto, seen):
        """p(d_upto = 1) from actions before step ``seen`` and all alerts up to ``upto``."""
        weight = np.zeros(2)
        for hidden in itertools.product((0, 1), repeat=upto + 1):
            probability, d = 1.0, 0
            for t, new in enumerate(hidden):
                eta = driver.eta * helped[t]
                p = max(0.0, driver.beta - eta) if d == 0 else 1 - min(1.0, driver.alpha + eta)
                probability *= p if new else 1 - p
                if t < seen:
                    probability *= applied[t] == (last[t] if new and t else intended[t])
                d = new
            weight[d] += probability
        return weight[1] / weight.sum()

    for t in range(config.horizon):
        last.append(int(teams.applied[0]))
        teams.turn(driver_policy.act, hmi.act)
        helped.append(int(teams.attention.accepted[0]))
        intended.append(int(teams.intended[0]))
        applied.append(int(teams.applied[0]))
        if t:
            before, after = entropy(belief(t, t)), entropy(belief(t, t + 1))
            sums["steps"] += 1
            sums["revealing"] += intended[-1] != last[-1]
            sums["entropy"] += before
            sums["information"] += before - after
            held = belief(t, t + 1) if teams.attention.distracted[0] else 1 - belief(t, t + 1)
            sums["log_loss"] -= np.log2(held)
    return sums


@pytest.mark.parametrize("name", ["bart", "marge", "average"])
def test_sums_are_those_of_all_hidden_sequences(name):
    config = TeamConfig(driver=name, duration=1.6, ai_sees_attention=False)
    seeds = [3, 8, 9]
    total, _ = counted(config, RevealingDriver(config, 0.4), "random:0.3", seeds).signals()
    assert 0 < total.revealing.sum() < total.steps.sum()
    for k, seed in enumerate(seeds):
        policies = RevealingDriver(config, 0.4), make_hmi("random:0.3", config)
        expected = by_enumeration(config, *policies, seed)
        found = {name: getattr(total, name)[k] for name in SUMS}
        assert found == pytest.approx(expected, abs=1e-9)


def test_an_episode_has_the_same_signals_in_any_company_and_order():
    driver = make_driver_policy("random", CROWDED)
    seeds = [5, 1, 10, 3]
    play_them = lambda these: counted(CROWDED, driver, "random:0.3", these, "batched").signals()  # noqa: E731
    together, parts = play_them(seeds)
    assert len(set(together.steps)) > 1, "some crash"
    backwards, parts_backwards = play_them(seeds[::-1])
    assert_same(backwards.of(np.arange(4)[::-1]), together)
    for k, seed in enumerate(seeds):
        alone, parts_alone = play_them([seed])
        assert_same(alone, together.of(np.array([k])))
        for group, labels in SITUATIONS.items():
            for label in labels:
                here = np.array([k])
                assert_same(parts_alone[group][label], parts[group][label].of(here))
                mirrored = parts_backwards[group][label].of(np.array([3 - k]))
                assert_same(mirrored, parts[group][label].of(here))


def test_nothing_counts_after_the_end_of_an_episode():
    config = TeamConfig(driver="bart", duration=4.0, ai_sees_attention=False)
    world = CrashingWorld(config.scene, 30)
    seeds = np.arange(30, dtype=np.uint64)
    counter, driver, hmi = SignalCounter(), RevealingDriver(config, 0.5), make_hmi("never", config)
    teams = play(begin(config, driver, hmi, seeds, world), driver, hmi, [counter])
    assert teams.steps.min() < 10
    np.testing.assert_array_equal(counter.signals()[0].steps, teams.steps - 1)


def test_one_situation_of_each_group_holds_in_every_step():
    longer = replace(CROWDED, duration=10.0)
    driver = make_driver_policy("random", longer)
    total, parts = counted(longer, driver, "random:0.3", range(40), "batched").signals()
    for part in parts.values():
        for name in SUMS:
            added = np.sum([getattr(each, name) for each in part.values()], axis=0)
            np.testing.assert_allclose(added, getattr(total, name), rtol=1e-9)
        assert all(each.steps.any() for each in part.values()), "all of them occur"


def test_situations_are_what_they_are_called():
    # The standing cars have 30 m at 15 m/s to the car ahead, and one merges at 3/4 of its speed.
    # The driver keeps action 0, the HMI always alerts.
    parts = counted(SHORT, RevealingDriver(SHORT, 0.0), "always", [4]).signals()[1]
    steps = {group: [int(each.steps[0]) for each in part.values()] for group, part in parts.items()}
    assert steps == {
        "last applied action": [9, 0, 0, 0, 0],
        "vehicle ahead": [9, 0],
        "ramp": [9, 0],
        "last alert": [9, 0],
    }
    silent = counted(SHORT, RevealingDriver(SHORT, 0.0), "never", [4]).signals()[1]
    assert silent["last alert"]["no alert"].steps.tolist() == [9]


@pytest.mark.parametrize(
    "config",
    [
        TeamConfig(driver="marge", ai_sees_attention=False),
        TeamConfig(
            driver=Driver("nona", 0.6, 0.1, 0.5, 1.0),
            alert_strengths=(0.5, 1.0),
            fatigue=Fatigue(10, 3, 0.9),
            ai_sees_attention=False,
        ),
    ],
    ids=["plain", "graded, with fatigue"],
)
def test_the_belief_is_calibrated(config):
    # The log loss of an exact belief is on average the entropy that is left.
    count = 400
    total, _ = counted(config, RevealingDriver(config, 0.3), "random:0.2", range(count)).signals()
    surprise = (total.log_loss - (total.entropy - total.information)) / total.steps
    assert abs(surprise.mean()) < 4 * surprise.std() / np.sqrt(count)
    assert surprise.std() < 0.2
    assert (total.entropy - total.information).mean() / 99 > 0.1, "there is something to get wrong"


def test_with_simultaneous_moves_the_same_is_learned():
    # Whether the HMI sees a^H_t before or after its alert changes nothing in what it knows then.
    class Late:
        sequential = False

        def reset(self, seeds, which=None):
            pass

        def act(self, observations):
            return np.zeros(len(observations), np.int64)

    counters = []
    for hmi in (make_hmi("never", SHORT), Late()):
        counter, driver = SignalCounter(), RevealingDriver(SHORT, 0.4)
        seeds = np.arange(8, dtype=np.uint64)
        world = StandingWorld(SHORT.scene, 8)
        play(begin(SHORT, driver, hmi, seeds, world), driver, hmi, [counter])
        counters.append(counter.signals()[0])
    assert counters[0].information.sum() > 1.0
    assert_same(*counters)


def test_signals_by_driver():
    seeds = np.arange(60, dtype=np.uint64)
    measured = measure_signalling(CROWDED, "random", "never", seeds)
    assert list(measured) == ["lisa", "bart"]
    assert sum(len(each.total.steps) for each in measured.values()) == 60
    for name, each in measured.items():
        assert each.driver == name
        assert each.share.low < 0.8 < each.share.high or abs(each.share.mean - 0.8) < 0.05
        # a^H is one of five, so that four of five steps reveal; both drivers have h(0.2) then
        bits = each.bits.mean / each.total.per_step("entropy").mean
        assert bits == pytest.approx(each.share.mean, abs=0.03)
        some = each.by_situation["last alert"]
        assert len(some["alert"].steps) == len(each.total.steps)
        assert not some["alert"].steps.any()
        assert np.isnan(some["alert"].per_step("revealing").mean)
    text = as_text(signalling_tables(list(measured.values())))
    assert "Signals by situation" in text
    assert "a vehicle merges" in text
    numbers = json.loads(json.dumps(measured["bart"].numbers(), allow_nan=False))
    assert numbers["revealing"] == measured["bart"].share.as_json()
    assert numbers["by_situation"]["last alert"]["alert"]["steps"] == 0
    assert (
        numbers["by_situation"]["last alert"]["no alert"]["information"] == numbers["information"]
    )
    share = revealing_share(CROWDED, "random", seeds, "never")
    revealing = sum(int(each.total.revealing.sum()) for each in measured.values())
    steps = sum(int(each.total.steps.sum()) for each in measured.values())
    assert share == revealing / steps


def test_counting_needs_steps():
    with pytest.raises(RuntimeError, match="play episodes"):
        SignalCounter().signals()


def test_an_observer_changes_no_episode():
    driver, hmi = make_driver_policy("random", CROWDED), make_hmi("random:0.3", CROWDED)
    counter = SignalCounter()
    with_it = play_episodes(CROWDED, driver, hmi, range(6), "batched", observers=[counter])
    without = play_episodes(CROWDED, driver, hmi, range(6), "batched")
    np.testing.assert_array_equal(with_it.attention_return(), without.attention_return())
    np.testing.assert_array_equal(counter.signals()[0].steps, with_it.length - 1)


# The gain of the Bayes filter.


@pytest.mark.parametrize("name", PAPER_DRIVERS)
def test_the_share_of_revealing_steps_explains_what_the_bayes_filter_earns(name):
    # Play and prediction agree, of the return and of the bits, and both rise together.
    config = TeamConfig(driver=name, ai_sees_attention=False)
    count, shares = 600, [0.0, 0.3, 1.0]
    predicted = filter_outcomes([name], shares, 7, 100, config.weights)[name]
    for share, exact in zip(shares, predicted, strict=True):
        hmi, driver, counter = (
            BeliefAlert(name, config, share),
            RevealingDriver(config, share),
            None,
        )
        counter = SignalCounter()
        world = StandingWorld(config.scene, count)
        played = play_episodes(config, driver, hmi, np.arange(count), world, observers=[counter])
        total, _ = counter.signals()
        found = {
            "share": (total.revealing / 99, share),
            "return": (played.attention_return(), exact.total_return),
            "bits": (total.information / 99, exact.bits),
        }
        for what, (values, expected) in found.items():
            margin = 4 * values.std() / np.sqrt(count) + 1e-9
            assert abs(values.mean() - expected) < margin, f"{what} at {share}"
        solved = solve_belief(name, 7, 100, config.weights, share).total_return
        assert exact.total_return == pytest.approx(solved, abs=0.5)
    assert np.all(np.diff([each.total_return for each in predicted]) > 10.0)
    assert np.all(np.diff([each.bits for each in predicted]) > 0.02)


def test_more_bits_are_more_return_for_every_driver():
    shares = np.linspace(0.0, 1.0, 11)
    for name, outcomes in filter_outcomes(list(DRIVERS), shares, 7, 30, SHORT.weights).items():
        returns, bits = np.array([(each.total_return, each.bits) for each in outcomes]).T
        assert np.all(np.diff(bits) > 0), name
        assert np.all(np.diff(returns) > 0), name
        assert bits[0] == 0.0
