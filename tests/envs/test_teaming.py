import numpy as np
import pytest
from standing_world import StandingWorld, standing_teams

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Driver, Traits
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import VEHICLE_ACTIONS

ALWAYS = Driver("always", beta=1.0, alpha=0.0, eta=0.0, inflation=1.0)
NEVER = Driver("never", beta=0.0, alpha=1.0, eta=0.0, inflation=1.0)


def seeds(count, first=0):
    return np.arange(first, first + count, dtype=np.uint64)


def test_a_distracted_driver_repeats_the_last_applied_action():
    teams = standing_teams(1, driver=ALWAYS)
    teams.reset(seeds(1))
    for intended in (3, 0, 4):
        teams.intend([intended])
        teams.step([0])
        assert teams.attention.distracted[0] == 1
    assert [int(actions[0]) for actions in teams.world.actions] == [3, 3, 3]  # v_0 = a^H_0


def test_an_attentive_driver_does_what_they_intend():
    teams = standing_teams(1, driver=NEVER)
    teams.reset(seeds(1))
    for intended in (3, 0, 4):
        teams.intend([intended])
        teams.step([0])
    assert [int(actions[0]) for actions in teams.world.actions] == [3, 0, 4]


def test_v_follows_the_papers_rule_whatever_happens():
    teams = standing_teams(300, driver=["bart", "homer", "average"])
    teams.reset(seeds(300))
    rng = np.random.default_rng(0)
    for step in range(30):
        before, intended = teams.applied.copy(), rng.integers(0, 5, 300)
        teams.intend(intended)
        teams.step(rng.integers(0, 2, 300))
        distracted = (teams.attention.distracted == 1) & (step > 0)
        assert np.array_equal(teams.applied, np.where(distracted, before, intended))


def test_rewards_of_a_step_by_hand():
    teams = standing_teams(1, driver=ALWAYS, reward="individual")
    teams.reset(seeds(1))
    teams.intend([VEHICLE_ACTIONS.index("move_right")])
    result = teams.step([0])
    terms = {name: float(value[0]) for name, value in result.terms.items()}
    assert terms == pytest.approx(
        {
            "collision": 0.0,
            "speed_reward": 5.0 * 15 / 30,
            "right_lane": 0.1,
            "merging": -0.1 * 0.25,
            "lane_change": -0.1,
            "distraction": -10.0,
            "alert": 10.0,  # d_0 = 0 and no alert
            "accept_alert": 0.0,
        }
    )
    assert result.rewards["driver"][0] == pytest.approx(2.5 + 0.1 - 0.025 - 0.1 - 10.0)
    assert result.rewards["vehicle_ai"][0] == 10.0


def test_time_ends_an_episode_by_truncation():
    teams = standing_teams(2, duration=0.6)
    teams.reset(seeds(2))
    for step in range(3):
        teams.intend([1, 1])
        result = teams.step([0, 0])
        assert result.truncated.tolist() == [step == 2] * 2
        assert not result.terminated.any()
    assert teams.over.all()


def test_a_crash_ends_an_episode_by_termination_even_in_the_last_step():
    teams = standing_teams(2, duration=0.2)
    teams.reset(seeds(2))
    teams.world.crash_next[0] = True
    teams.intend([1, 1])
    result = teams.step([0, 0])
    assert result.terminated.tolist() == [True, False]
    assert result.truncated.tolist() == [False, True]
    assert result.terms["collision"].tolist() == [-5.0, 0.0]


def test_ended_teams_stay_as_they_are_and_earn_nothing():
    teams = standing_teams(2, driver="bart")
    teams.reset(seeds(2))
    teams.world.crash_next[0] = True
    teams.intend([3, 3])
    teams.step([1, 1])
    ended = teams.state()[0].copy()
    for _ in range(5):
        teams.intend([99, 4])  # an ended team's action is not even read
        result = teams.step([99, 0])
        assert result.terms["speed_reward"].tolist() == [0.0, 2.5]
        assert float(result.rewards["driver"][0]) == 0.0
    np.testing.assert_array_equal(teams.state()[0], ended)
    assert teams.steps.tolist() == [1, 6]


def test_without_an_end_at_the_crash_the_car_stands_and_the_rest_goes_on():
    teams = standing_teams(2, driver=ALWAYS, duration=1.0, end_at_crash=False)
    teams.reset(seeds(2))
    teams.world.crash_next[0] = True
    results = []
    for _ in range(5):
        teams.intend([1, 1])
        results.append(teams.step([1, 0]))
    assert [bool(moved[0]) for moved in teams.world.moved] == [True] + 4 * [False]
    assert [float(r.terms["collision"][0]) for r in results] == [-5.0] * 5
    assert [float(r.terms["speed_reward"][0]) for r in results] == [2.5, 0, 0, 0, 0]
    assert [float(r.terms["distraction"][0]) for r in results] == [-10.0] * 5
    assert teams.steps.tolist() == [5, 5]
    assert results[-1].truncated.tolist() == [True, True]
    assert not results[-1].terminated.any()


def test_team_k_is_the_same_alone_and_among_many():
    drivers = ["lisa", "marge", "bart", "homer"]
    many, settings = 257, {"driver": drivers, "duration": 4.0}
    actions = np.random.default_rng(1).integers(0, 5, (20, many))
    alerts = np.random.default_rng(2).integers(0, 2, (20, many))

    def play(which):
        teams = standing_teams(len(which), **settings)
        teams.reset(seeds(many)[which])
        states = []
        for step in range(20):
            teams.intend(actions[step, which])
            teams.step(alerts[step, which])
            states.append(teams.state())
        return np.array(states)

    together = play(np.arange(many))
    np.testing.assert_array_equal(play(np.array([13])), together[:, [13]])
    np.testing.assert_array_equal(play(np.array([200, 7, 99])), together[:, [200, 7, 99]])


def test_some_teams_can_start_anew_while_others_go_on():
    teams = standing_teams(3, driver="bart", duration=4.0)
    teams.reset(seeds(3))
    for _ in range(4):
        teams.intend([3, 3, 3])
        teams.step([1, 1, 1])
    kept = teams.state()[[0, 2]]
    teams.reset(seeds(3, first=50), np.array([False, True, False]))
    np.testing.assert_array_equal(teams.state()[[0, 2]], kept)
    fresh = standing_teams(1, driver="bart", duration=4.0)
    fresh.reset(np.array([51], np.uint64))
    np.testing.assert_array_equal(teams.state()[1], fresh.state()[0])
    assert teams.seeds.tolist() == [0, 51, 2]


def in_mid_turn():
    """Three teams of which all drivers have acted in the third step."""
    teams = standing_teams(3, driver="bart", duration=4.0)
    teams.reset(seeds(3))
    for intended in ([3, 3, 3], [0, 1, 2]):
        teams.intend(intended)
        teams.step([1, 0, 1])
    teams.intend([4, 3, 4])
    return teams


OTHERS, SECOND = np.array([True, False, True]), np.array([False, True, False])


def test_a_partial_reset_in_mid_turn_leaves_the_other_teams_there():
    teams = in_mid_turn()
    before = teams.state()
    teams.reset(seeds(3, first=50), SECOND)
    np.testing.assert_array_equal(teams.state()[OTHERS], before[OTHERS])
    previous = teams.state_layout.chosen(teams.state(), "previous_intended_action")
    assert previous.tolist() == [0, -1, 2]
    assert teams.intent_given.tolist() == OTHERS.tolist()
    with pytest.raises(ValueError, match="the driver acts first"):
        teams.step([0, 0, 0])
    with pytest.raises(ValueError, match="already acted"):
        teams.intend([1, 1, 1])
    np.testing.assert_array_equal(teams.state()[OTHERS], before[OTHERS])
    teams.intend([99, 1, 99], SECOND)  # the others' actions are not even read
    np.testing.assert_array_equal(teams.state()[OTHERS], before[OTHERS])
    teams.step([0, 0, 0])
    assert not teams.intent_given.any()
    undisturbed = in_mid_turn()
    undisturbed.step([0, 0, 0])
    np.testing.assert_array_equal(teams.state()[OTHERS], undisturbed.state()[OTHERS])
    fresh = standing_teams(1, driver="bart", duration=4.0)
    fresh.reset(np.array([51], np.uint64))
    fresh.intend([1])
    fresh.step([0])
    np.testing.assert_array_equal(teams.state()[1], fresh.state()[0])


def test_an_intent_that_is_withdrawn_leaves_nothing_behind():
    teams, undisturbed = (standing_teams(2, driver="bart") for _ in range(2))
    for each in (teams, undisturbed):
        each.reset(seeds(2))
    for step in range(3):
        before = teams.state()
        teams.intend([4, 0])
        assert not np.array_equal(teams.state(), before)
        teams.withdraw()
        np.testing.assert_array_equal(teams.state(), before)
        for each in (teams, undisturbed):
            each.intend([step, 3])
        np.testing.assert_array_equal(teams.state(), undisturbed.state())
        for each in (teams, undisturbed):
            each.step([0, 1])
    np.testing.assert_array_equal(teams.state(), undisturbed.state())


def test_the_ai_sees_intent_in_its_turn_and_one_step_late_otherwise():
    teams = standing_teams(1, driver=NEVER)
    layout = teams.layouts["vehicle_ai"]
    teams.reset(seeds(1))

    def intents():
        seen = teams.observe("vehicle_ai")
        return tuple(
            int(layout.chosen(seen, part)[0])
            for part in ("intended_action", "previous_intended_action", "applied_action")
        )

    assert intents() == (-1, -1, -1)
    teams.intend([3])
    assert intents() == (3, -1, -1)
    teams.step([0])
    assert intents() == (3, 3, 3)  # before the next turn the latest a^H is the last step's
    teams.intend([4])
    assert intents() == (4, 3, 3)


def test_seats_and_state_agree_on_what_they_share():
    teams = standing_teams(4, driver=["bart", "homer"])
    teams.reset(seeds(4))
    teams.intend([0, 1, 2, 3])
    teams.step([0, 1, 0, 1])
    state, whole = teams.state(), teams.state_layout
    for agent, layout in teams.layouts.items():
        seen = teams.observe(agent)
        for part in layout.slices:
            if part != "lidar":
                np.testing.assert_array_equal(layout.get(seen, part), whole.get(state, part))
    traits = whole.get(state, "traits")
    np.testing.assert_allclose(traits[:, 0], teams.traits.beta)
    np.testing.assert_allclose(traits[:, 3] * 20, teams.traits.inflation, rtol=1e-6)


@pytest.mark.parametrize(
    ("act", "error", "message"),
    [
        (lambda teams: teams.intend([0, 5]), ValueError, "driver action 5 is out of range"),
        (lambda teams: teams.intend([-1, 0]), ValueError, "driver action -1 is out of range"),
        (lambda teams: teams.intend([0]), ValueError, r"shape \(2,\), but got \(1,\)"),
        (lambda teams: teams.intend([0.5, 1.0]), TypeError, "integers"),
        (lambda teams: teams.step([0, 0]), ValueError, "the driver acts first"),
        (lambda teams: teams.reset(seeds(3)), ValueError, r"shape \(2,\), not \(3,\)"),
        (lambda teams: teams.reset([0.5, 1.0]), TypeError, "seeds are integers.*float64"),
        (lambda teams: teams.reset([True, False]), TypeError, "seeds are integers.*bool"),
        (lambda teams: teams.reset([3, -1]), ValueError, r"seed lies in \[0, 2\^64\), but got -1"),
        (lambda teams: teams.reset(seeds(2), np.array([1, 0])), ValueError, "which= marks teams"),
        (lambda teams: teams.reset(seeds(2), np.array([True])), ValueError, "which= marks teams"),
        (lambda teams: teams.intend([0, 0], [0, 1]), ValueError, "which= marks teams"),
    ],
)
def test_bad_calls_are_refused(act, error, message):
    teams = standing_teams(2)
    teams.reset(seeds(2))
    with pytest.raises(error, match=message):
        act(teams)


def test_the_seed_of_a_team_that_goes_on_is_not_read():
    teams = standing_teams(2)
    teams.reset(seeds(2))
    teams.reset([-1, 7], np.array([False, True]))
    assert teams.seeds.tolist() == [0, 7]


class Sleepwalkers:
    """A population of drivers that cannot be."""

    def draw(self, seeds):
        unit = np.full(len(seeds), 0.5)
        return Traits(np.where(seeds > 9, np.nan, unit), unit, unit, unit + 1)


def test_impossible_traits_are_refused_before_anything_changes():
    teams = standing_teams(2, driver=Sleepwalkers())
    teams.reset(seeds(2))
    before = teams.state()
    with pytest.raises(ValueError, match=r"beta lies in \[0, 1\], but got nan"):
        teams.reset(seeds(2, first=9))
    np.testing.assert_array_equal(teams.state(), before)
    assert teams.seeds.tolist() == [0, 1]


def test_acting_twice_or_alerting_out_of_range_is_refused():
    teams = standing_teams(1)
    teams.reset(seeds(1))
    teams.intend([0])
    with pytest.raises(ValueError, match="already acted"):
        teams.intend([0])
    with pytest.raises(ValueError, match="vehicle_ai action 2 is out of range"):
        teams.step([2])
    teams.step([1])  # the failed call changed nothing
    assert teams.steps.tolist() == [1]


def test_a_world_that_does_not_fit_is_refused():
    config = TeamConfig()
    for world in (None, 3, StandingWorld):
        with pytest.raises(TypeError, match="world= takes a world's name or a World, not"):
            Teaming(config, 2, world)
    with pytest.raises(ValueError, match="num_teams = 2, but the world has 3 scenes"):
        Teaming(config, 2, StandingWorld(config.scene, 3))
    with pytest.raises(ValueError, match=r"make it with config\.scene"):
        Teaming(config, 2, StandingWorld(Scene(lanes=2).fitted(20.0), 2))


def test_there_is_at_least_one_team():
    with pytest.raises(ValueError, match="num_teams lies in"):
        Teaming(standing_teams(1).config, 0)


# Another driver takes the wheel.

BOTH = {"driver": ["bart", "homer"], "duration": 4.0}
NEW = Traits.of([ALWAYS, Driver("calm", 0.0, 1.0, 0.5, inflation=7.0), NEVER])


def on_the_way(world=None):
    """Three teams after four steps, every driver helped by an alert."""
    config = TeamConfig(**BOTH)
    teams = Teaming(config, 3, world or StandingWorld(config.scene, 3))
    teams.reset(seeds(3))
    for intended in ([3, 3, 3], [0, 1, 2], [3, 3, 4], [1, 3, 1]):
        teams.intend(intended)
        teams.step([1, 1, 1])
    return teams


def columns(teams, *names):
    layout = teams.state_layout
    return np.concatenate([layout.get(teams.state(), name) for name in names], axis=1)


def test_another_driver_begins_attentive_in_the_same_car():
    teams = on_the_way()
    goes_on = "speed", "position", "intended_action", "applied_action", "alerted", "time"
    before = columns(teams, *goes_on)
    assert teams.attention.accepted.all()
    teams.hand_over(NEW)
    np.testing.assert_array_equal(columns(teams, *goes_on), before)
    np.testing.assert_array_equal(teams.traits.as_array(), NEW.as_array())
    assert not columns(teams, "distracted", "accepted", "counter").any()
    applied = teams.applied.copy()
    teams.intend([4, 4, 4])
    result = teams.step([0, 0, 0])
    # the one is always distracted and keeps v, the others never
    assert teams.attention.distracted.tolist() == [1, 0, 0]
    assert teams.applied.tolist() == [applied[0], 4, 4]
    assert result.terms["alert"].tolist() == [10.0] * 3, "d was 0 before"


def test_marked_teams_alone_change_drivers():
    teams, undisturbed = on_the_way(), on_the_way()
    teams.hand_over(NEW, SECOND)
    np.testing.assert_array_equal(teams.state()[OTHERS], undisturbed.state()[OTHERS])
    np.testing.assert_array_equal(teams.traits.as_array()[1], NEW.as_array()[1])
    for _ in range(10):
        for each in (teams, undisturbed):
            each.intend([3, 0, 4])
            each.step([0, 1, 0])
        np.testing.assert_array_equal(teams.state()[OTHERS], undisturbed.state()[OTHERS])
    assert (teams.state()[1] != undisturbed.state()[1]).any()


def test_a_new_episode_is_driven_by_whom_the_population_draws():
    teams, undisturbed = on_the_way(), on_the_way()
    teams.hand_over(NEW)
    for each in (teams, undisturbed):
        each.reset(seeds(3, first=20))
    np.testing.assert_array_equal(teams.state(), undisturbed.state())


@pytest.mark.parametrize(
    ("traits", "which", "error", "message"),
    [
        (Traits.of([ALWAYS, NEVER]), None, ValueError, r"beta is an array .* shape \(3,\)"),
        (NEW.as_array(), None, TypeError, "a Population draws Traits, not"),
        (
            Traits.from_array(NEW.as_array() * [1, 1, 1, 9]),
            None,
            ValueError,
            r"inflation lies in \[1, 20\], but got 63",
        ),
        (NEW, np.array([True]), ValueError, "which= marks teams by bools"),
        (NEW, np.array([1, 0, 1]), ValueError, "which= marks teams by bools"),
    ],
)
def test_a_hand_over_to_no_driver_is_refused_and_changes_nothing(traits, which, error, message):
    teams = on_the_way()
    before = teams.state()
    with pytest.raises(error, match=message):
        teams.hand_over(traits, which)
    np.testing.assert_array_equal(teams.state(), before)


def test_no_driver_takes_the_wheel_in_mid_turn():
    teams = on_the_way()
    teams.intend([1, 1, 1], SECOND)
    before = teams.state()
    for which in (None, SECOND):
        with pytest.raises(ValueError, match=r"between turns; alert with step\(\) first"):
            teams.hand_over(NEW, which)
    np.testing.assert_array_equal(teams.state(), before)
    teams.hand_over(NEW, OTHERS)  # where no driver has acted in the turn
    np.testing.assert_array_equal(teams.state()[1], before[1])


@pytest.mark.parametrize("world", ["highway", "batched"])
def test_the_new_driver_sees_with_their_own_eyes(world):
    settings = {"duration": 4.0, "scene": Scene(vehicles=20)}
    small, large = (Driver("any", 0.0, 1.0, 0.0, inflation) for inflation in (1.0, 3.0))

    def drive(before, after):
        """Both lidars of the driver's and the AI's seat before and after, and after a step."""
        config = TeamConfig(driver=before, **settings)
        teams = Teaming(config, 2, world)
        teams.reset(seeds(2, 5))
        seen = []

        def look():
            for seat in ("driver", "vehicle_ai"):
                seen.append(teams.layouts[seat].get(teams.observe(seat), "lidar"))

        for _ in range(3):
            teams.intend([1, 1])
            teams.step([0, 0])
        look()
        teams.hand_over(Traits.of([after, after]), np.array([True, False]))
        look()
        teams.intend([1, 1])
        teams.step([0, 0])
        look()
        return seen

    changed = drive(small, large)
    all_small, all_large = drive(small, small), drive(large, large)
    for k in range(6):
        np.testing.assert_array_equal(changed[k][1], all_small[k][1])  # no new driver there
        theirs = all_large if k in (2, 4) else all_small  # the driver's seat, from then on
        np.testing.assert_array_equal(changed[k][0], theirs[k][0])
    assert (all_small[2][0] != all_large[2][0]).any()
