"""The rules of a step give the same bits in NumPy, in loops, and in one loop with the world."""

import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from standing_world import StandingWorld
from step_ways import CONFIGS, WAYS, play, room_of, teams_of

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import TraitDistributions
from hmi_marl.envs.elementwise import put, put_one_hot, put_row, put_scaled, within
from hmi_marl.envs.execution import InNumPy, WrongActionError
from hmi_marl.envs.loops import InLoops, InOneLoop
from hmi_marl.envs.observation_values import PARTS, first_columns
from hmi_marl.envs.observations import driver_layout, state_layout, vehicle_ai_layout
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.series import Series
from hmi_marl.envs.step_result import Then
from hmi_marl.envs.team_step import ALERTS, CRASHES, LENGTH, OF_BOTH, SUMS
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds.batched import BatchedWorld


@pytest.mark.parametrize("with_series", [False, True])
@pytest.mark.parametrize("name", CONFIGS)
def test_all_ways_give_the_same_bits(name, with_series):
    config = TeamConfig(duration=3.0, scene=Scene(vehicles=(8, 20)), **CONFIGS[name])
    played = []
    for kind in (InNumPy, InLoops, InOneLoop):
        teams = teams_of(kind, config, 21)
        seeds = np.arange(21, dtype=np.uint64) + np.uint64(3)
        teams.reset(seeds)
        series = Series(seeds, config.population) if with_series else None
        played.append(play(teams, 40, 5, series))
    for others in played[1:]:
        assert len(others) == len(played[0])
        for ours, theirs in zip(played[0], others, strict=True):
            assert ours.dtype == theirs.dtype
            assert ours.tobytes() == theirs.tobytes()


def test_threads_do_not_change_what_the_loop_does():
    config = TeamConfig(driver=["lisa", "homer"], duration=3.0)
    seeds = np.arange(70, dtype=np.uint64)
    played = []
    for threads in (1, 2):
        teams = Teaming(config, 70, BatchedWorld(config.scene, 70, min(threads, 2)))
        teams.reset(seeds)
        played.append(play(teams, 20, 1, Series(seeds, config.population)))
    for ours, theirs in zip(*played, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_next_episodes_are_those_of_teams_that_are_reset_by_hand():
    config = TeamConfig(driver=["lisa", "homer"], duration=1.0)
    seeds = np.arange(4, dtype=np.uint64)
    ours, theirs = (Teaming(config, 4, "batched") for _ in range(2))
    series, again = Series(seeds, config.population), Series(seeds, config.population)
    for teams in (ours, theirs):
        teams.reset(seeds)
    rng = np.random.default_rng(0)
    for _ in range(Series.AHEAD * 5 + 12):  # beyond what was computed ahead
        actions, alerts = rng.integers(0, 5, 4), rng.integers(0, 2, 4)
        ours.intend(actions)
        theirs.intend(actions)
        result = ours.step(alerts, ("state",), Then(series, ("state",)))
        by_hand = theirs.step(alerts)
        np.testing.assert_array_equal(result.table, by_hand.table)
        if by_hand.ended.any():
            teams = np.flatnonzero(by_hand.ended)
            ended = result.ended_teams
            np.testing.assert_array_equal(ended.teams, teams)
            np.testing.assert_array_equal(ended.views["state"], theirs.state()[teams])
            assert set(ended.totals[:, LENGTH]) <= {1.0, 2.0, 3.0, 4.0, 5.0}
            theirs.begin(teams, again.go_on(teams)[0])
        else:
            assert result.ended_teams is None
        np.testing.assert_array_equal(result.views["state"], theirs.state())
        np.testing.assert_array_equal(ours.seeds, theirs.seeds)
        assert not ours.over.any()


def test_totals_of_an_episode_by_hand():
    config = TeamConfig(driver="homer", duration=1.0, reward="individual")
    world = StandingWorld(config.scene, 1)
    teams = Teaming(config, 1, world)
    seeds = np.array([3], np.uint64)
    teams.reset(seeds)
    then = Then(Series(seeds, config.population))
    tables = []
    for alert in (1, 0, 1, 0, 0):
        teams.intend([1])
        result = teams.step([alert], then=then)
        tables.append(result.table[0])
    (totals,) = result.ended_teams.totals
    np.testing.assert_allclose(totals[:11], np.sum(tables, axis=0))
    assert totals[OF_BOTH] == pytest.approx(np.sum(tables, axis=0)[8:10].sum())
    assert (totals[LENGTH], totals[ALERTS], totals[CRASHES]) == (5.0, 2.0, 0.0)


def test_what_was_returned_stays_as_it_is():
    config = TeamConfig(driver=["lisa", "homer"])
    for world in ("batched", "highway"):
        teams = Teaming(config, 2, world)
        teams.reset([1, 2])
        teams.intend([3, 1])
        result = teams.step([1, 0], ("state", "driver"))
        held = [
            *vars(teams.attention).values(),
            *vars(teams.traits).values(),
            *vars(teams.ego).values(),
            *(getattr(teams, name) for name in ("steps", "applied", "intended", "seeds", "over")),
            result.table,
            result.ends,
            *result.views.values(),
            teams.state(),
        ]
        kept = [array.copy() for array in held]
        for _ in range(4):
            teams.intend([0, 4])
            teams.step([0, 1], ("state",))
        teams.reset([5, 6])
        for ours, theirs in zip(held, kept, strict=True):
            np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("kind", [InNumPy, InLoops, InOneLoop])
def test_traits_are_shown_as_they_are_and_scores_are_columns_of_the_table(kind):
    config = TeamConfig(driver=TraitDistributions(), duration=0.4, reward="individual")
    teams = teams_of(kind, config, 3)
    series = Series(np.arange(3, dtype=np.uint64), config.population)
    teams.reset(series.present)
    rng = np.random.default_rng(0)
    for step in range(4):
        traits = teams.traits.as_array().astype(np.float32)
        np.testing.assert_array_equal(teams.views(("traits",))["traits"], traits)
        room = teams.room((), (OF_BOTH, 1))
        _, rewards, dones, late = room.scores
        actions, then = rng.integers(0, 5, 3), Then(series, ("traits",))
        result = teams.turn(actions, np.array([1, 0, 1]), views=room, then=then)
        table = result.table
        both = (table[:, 8] + table[:, 9]).astype(np.float32)
        np.testing.assert_array_equal(rewards, [both, table[:, 1].astype(np.float32)])
        np.testing.assert_array_equal(dones, result.ended)
        np.testing.assert_array_equal(late, result.truncated)
        assert result.ended.all() == (step % 2 == 1)
        if result.ended.all():
            np.testing.assert_array_equal(result.ended_teams.views["traits"], traits)
            assert (teams.traits.as_array().astype(np.float32) != traits).any()


@pytest.mark.parametrize("kind", [InNumPy, InLoops])
@pytest.mark.parametrize(
    ("actions", "team", "column"),
    [
        (np.array([[0, 1], [4, 2]]), 1, 1),
        (np.array([[5, 0], [0, 0]]), 0, 0),
        (np.array([[0, 0], [-1, 0]]), 1, 0),
        (np.array([[0.0, 0.5], [0.0, 0.0]]), 0, 1),
        (np.array([[0.0, 0.0], [np.nan, 0.0]]), 1, 0),
        (np.array([[0.0, np.inf], [0.0, 0.0]], np.float32), 0, 1),
        (np.array([[1e30, 0.0], [0.0, 0.0]]), 0, 0),
    ],
)
def test_an_action_that_is_none_is_named(kind, actions, team, column):
    execution = teams_of(kind, TeamConfig(), 2)._execution
    with pytest.raises(WrongActionError) as error:
        execution.whole(actions, (5, 2))
    assert (error.value.team, error.value.column) == (team, column)
    good = np.array([[4, 1], [0, 0]]).astype(actions.dtype)
    np.testing.assert_array_equal(execution.whole(good, (5, 2)), [[4, 0], [1, 0]])


@pytest.mark.parametrize("kind", [InNumPy, InLoops, InOneLoop])
def test_nothing_changes_where_an_action_is_refused(kind):
    teams = teams_of(kind, TeamConfig(driver="homer"), 3)
    teams.reset([1, 2, 3])
    before = teams.state()
    with pytest.raises(ValueError, match="driver action 7 is out of range: it is one of 0 to 4"):
        teams.intend([0, 7, 9])
    with pytest.raises(ValueError, match="the driver acts first"):
        teams.step([0, 0, 0])
    np.testing.assert_array_equal(teams.state(), before)
    teams.intend([0, 1, 2])
    with pytest.raises(ValueError, match="already acted"):
        teams.intend([0, 0, 0])
    with pytest.raises(ValueError, match="vehicle_ai action -1 is out of range"):
        teams.step([0, -1, 0])
    assert teams.intent_given.all()
    assert (teams.steps == 0).all()
    np.testing.assert_array_equal(teams.intended, [0, 1, 2])


def test_actions_of_teams_that_are_over_are_not_read():
    teams = Teaming(TeamConfig(driver="homer"), 17, "batched")
    teams.reset(np.arange(17), np.arange(17) < 9)
    wild = np.where(np.arange(17) < 9, 1, 10**15)
    teams.intend(wild)
    teams.step(np.where(np.arange(17) < 9, 1, -(10**15)))
    np.testing.assert_array_equal(teams.steps, np.arange(17) < 9)


def test_every_part_of_every_layout_is_written():
    for settings_ in CONFIGS.values():
        config = TeamConfig(**settings_)
        for agent, layout in (
            ("driver", driver_layout(config)),
            ("vehicle_ai", vehicle_ai_layout(config)),
            ("state", state_layout(config)),
        ):
            first = first_columns(layout, agent)
            assert sorted(first[first >= 0]) == sorted(s.start for s in layout.slices.values())
    with pytest.raises(KeyError, match="no part 'fatigue'"):
        first_columns(driver_layout(TeamConfig()), "driver", ["fatigue"])
    assert len(set(PARTS)) == len(PARTS)


@settings(max_examples=30)
@given(
    st.lists(st.floats(-(2.0**126), 2.0**126, width=32), min_size=3, max_size=3),
    st.integers(-1, 2),
    st.floats(0.5, 4.0, width=32),
)
def test_the_building_blocks_by_hand(values, index, scale):
    rows = np.full((1, 8), 9.0, np.float32)
    low, high = np.float32(-1.0), np.float32(2.0)
    for column, value in enumerate(values):
        put(rows, slice(None), column, low, high, np.array([value]))
    put_one_hot(rows, slice(None), 3, np.array([index]), 3)
    put(rows, slice(None), -1, low, high, np.array([5.0]))
    expected = np.clip(np.array(values, np.float32), low, high)
    np.testing.assert_array_equal(rows[0, :3], expected)
    assert rows[0, 3:6].tolist() == [float(index == k) for k in range(3)]
    assert rows[0, 6:].tolist() == [9.0, 9.0]
    put_row(rows, 0, 6, np.array([3.0, 4.0], np.float32))
    assert rows[0, 6:].tolist() == [3.0, 4.0]
    table = np.array([[values[:2]]], np.float32)
    out = np.empty((1, 2), np.float32)
    put_scaled(out, slice(None), 0, table, np.float32(scale), np.float32(2.0))
    with np.errstate(over="ignore"):
        wanted = np.clip(table / np.float32(scale), -2.0, 2.0).reshape(1, 2)
    np.testing.assert_array_equal(out, wanted)
    assert within(np.nan, 0.0, 1.0) != within(np.nan, 0.0, 1.0)  # stays NaN


def test_a_subclass_of_the_batched_world_is_called_like_any_world():
    class Foggy(BatchedWorld):
        def lidar(self, inflated):
            return np.full_like(super().lidar(inflated), 12.0)

    config = TeamConfig(driver="homer")
    for count in (2, 20):
        teams = Teaming(config, count, Foggy(config.scene, count, 1))
        teams.reset(np.arange(count))
        lidar = teams.layouts["driver"].get(teams.observe("driver"), "lidar")
        np.testing.assert_allclose(lidar, 0.2)


def test_names_of_the_batched_world_mean_nothing_on_another():
    class Named(StandingWorld):
        readings, begin, take_step, arrays = [], 3, "", None

    config = TeamConfig(driver="homer", duration=1.0)
    for count in (1, 20):
        teams = Teaming(config, count, Named(config.scene, count))
        teams.reset(np.arange(count))
        assert (teams.turn(np.ones(count, int), np.zeros(count, int)).table[:, 1] > 0).all()


def test_a_world_may_keep_what_it_was_given():
    config = TeamConfig(driver=TraitDistributions())

    class Keeping(StandingWorld):
        def reset(self, seeds, inflation, which):
            self.kept = seeds, inflation
            super().reset(seeds, inflation, which)

    for count in (2, 20):
        world = Keeping(config.scene, count)
        teams = Teaming(config, count, world)
        teams.reset(np.arange(count))
        kept = world.kept
        copies = [array.copy() for array in kept]
        teams.reset(np.arange(count) + 50, np.arange(count) < 1)
        for array, copy in zip(kept, copies, strict=True):
            np.testing.assert_array_equal(array, copy)


@pytest.mark.parametrize("wrong", [[-1], [4], [0, 0], [[0]], [2**40]])
def test_numbers_of_teams_that_there_are_not(wrong):
    teams = Teaming(TeamConfig(), 4, "batched")
    teams.reset([1, 2, 3, 4])
    with pytest.raises(ValueError, match="teams= are"):
        teams.views(("vehicle_ai",), np.array(wrong))
    with pytest.raises(ValueError, match="teams= are"):
        teams.begin(np.array(wrong), np.zeros(len(wrong), np.uint64))
    with pytest.raises(ValueError, match="seeds of 1 teams"):
        teams.begin(np.array([1]), np.zeros(2, np.uint64))


def test_a_turn_that_cannot_be_taken_leaves_no_team_in_mid_turn():
    teams = Teaming(TeamConfig(), 2, "batched")
    teams.reset([1, 2])
    before = teams.state()
    for wrong, error in (
        (lambda: teams.turn([1, 1], [0, 0], views=("drivers",)), KeyError),
        (lambda: teams.turn([1, 1], [0, 7]), ValueError),
        (lambda: teams.turn([1, 1], [0, 7], sequential=False), ValueError),
    ):
        with pytest.raises(error):
            wrong()
        np.testing.assert_array_equal(teams.state(), before)
    teams.turn([1, 1], [0, 0])


@pytest.mark.parametrize("way", WAYS)
def test_a_world_that_fails_leaves_no_team_in_mid_turn(way):
    config = TeamConfig()
    teams = teams_of(way, config, 2)
    teams.reset([1, 2])
    move = "take_step" if way is InOneLoop else "step"
    moves, before = getattr(teams.world, move), teams.state()

    def fail(*arguments):
        raise OSError("no road")

    for asked in ([0, 0], lambda observations: np.zeros(2, int)):
        setattr(teams.world, move, fail)
        with pytest.raises(OSError, match="no road"):
            teams.turn([1, 1], asked)
        assert not teams.intent_given.any()
        np.testing.assert_array_equal(teams.state(), before)
    setattr(teams.world, move, moves)
    teams.turn([1, 1], [0, 0])
    # Drivers who had acted before the turn keep their actions.
    teams.intend([1, 1])
    with pytest.raises(ValueError, match="already acted"):
        teams.turn([2, 2], [0, 0])
    assert teams.intent_given.all()


def wrong_arrays(shape, dtype):
    """Arrays that a loop of this shape and type would not fill as it should."""
    right = np.zeros(shape, dtype)
    read_only = right.copy()
    read_only.flags.writeable = False
    wrong = [right.tolist(), right[:-1], right[..., None], right.astype(">f4"), read_only]
    if right.itemsize > 1:  # at an odd address
        memory = np.frombuffer(bytearray(right.nbytes + 1), np.uint8)[1:]
        wrong.append(memory.view(dtype).reshape(shape))
    return [*wrong, np.zeros((2, *shape), dtype)[0, ::-1], np.zeros(shape, np.float16)]


@pytest.mark.parametrize("world", ["batched", "highway"])
def test_room_is_filled_by_the_teams_that_made_it(world):
    config = TeamConfig()
    teams, other = Teaming(config, 2, world), Teaming(config, 2, world)
    teams.reset([1, 2])
    before, copied = teams.state(), pickle.loads(pickle.dumps(teams))
    for stranger in (other, copied, Teaming(config, 3, world)):
        room = room_of(stranger)
        for fill in (lambda room: teams.turn([1, 1], [0, 0], views=room), teams.views):
            with pytest.raises(ValueError, match="filled by the teams that made it"):
                fill(room)
        np.testing.assert_array_equal(teams.state(), before)
        assert all((group.rows == -9).all() for group in room.groups.values())
    room = room_of(teams)
    with pytest.raises(ValueError, match="filled by the teams that made it"):
        teams.views(room, np.array([1]))
    result = teams.turn([1, 1], [0, 0], views=room)
    np.testing.assert_array_equal(room.groups["driver"].rows, teams.observe("driver"))
    np.testing.assert_array_equal(room.scores.rewards, result.table.T.astype(np.float32))
    result = teams.turn([1, 1], [0, 0], views=room.without_views())
    assert not result.views
    np.testing.assert_array_equal(room.scores.rewards, result.table.T.astype(np.float32))


@pytest.mark.parametrize("columns", [(-1,), (SUMS,), (0, 2**40)])
def test_rewards_are_columns_of_the_table(columns):
    teams = Teaming(TeamConfig(), 2, "batched")
    for _ in range(2):
        with pytest.raises(ValueError, match="columns of rewards lie in"):
            teams.room(("driver",), columns)
    with pytest.raises(KeyError):
        teams.room(("drivers",))


@pytest.mark.parametrize("world", ["batched", "highway"])
def test_a_series_fits_the_teams_and_keeps_its_arrays(world):
    config = TeamConfig()
    teams = Teaming(config, 2, world)
    teams.reset([1, 2])
    before = teams.state()
    few = Series(np.arange(1, dtype=np.uint64), config.population)
    given = [(few, "series.episodes")]
    for name in ("episodes", "seeds", "traits"):
        right = getattr(Series(np.arange(2, dtype=np.uint64), config.population), name)
        for wrong in wrong_arrays(right.shape, right.dtype):
            series = Series(np.arange(2, dtype=np.uint64), config.population)
            setattr(series, name, wrong)
            given.append((series, f"series.{name}"))
    for series, name in given:
        with pytest.raises(ValueError, match=f"{name} is a writable array of"):
            teams.turn([1, 1], [0, 0], then=Then(series))
        np.testing.assert_array_equal(teams.state(), before)


def test_a_second_teaming_on_a_world_sees_its_lidars():
    config = TeamConfig(driver="homer")
    world = BatchedWorld(config.scene, 2, 1)
    first = Teaming(config, 2, world)
    first.reset([1, 2])
    seen = first.layouts["vehicle_ai"].get(first.observe("vehicle_ai"), "lidar")
    second = Teaming(config, 2, world)
    np.testing.assert_array_equal(
        second.layouts["vehicle_ai"].get(second.observe("vehicle_ai"), "lidar"), seen
    )


def test_teams_that_were_mapped_into_memory_go_on(tmp_path):
    joblib = pytest.importorskip("joblib")
    config = TeamConfig(driver=["lisa", "homer"])
    teams = Teaming(config, 20, BatchedWorld(config.scene, 20, 1))
    series = Series(np.arange(20, dtype=np.uint64), config.population)
    teams.reset(series.present)
    play(teams, 12, 1, series)
    joblib.dump((teams, series), tmp_path / "teams")
    theirs, their_series = joblib.load(tmp_path / "teams", mmap_mode="r")
    ours = play(teams, 30, 2, series)
    for one, other in zip(ours, play(theirs, 30, 2, their_series), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_population_that_fails_later_changes_nothing():
    class Tiring:
        calls = 0

        def draw(self, seeds):
            Tiring.calls += 1
            if Tiring.calls > 3:
                raise OSError("no more drivers")
            return TeamConfig(driver=["lisa", "homer"]).population.draw(seeds)

    config = TeamConfig(driver=Tiring(), duration=0.4)
    teams = Teaming(config, 2, "batched")
    seeds = np.array([1, 2], np.uint64)
    teams.reset(seeds)
    then = Then(Series(seeds, config.population), ("state",))
    failed = False
    while not failed:
        before = teams.state(), teams.steps
        try:
            teams.turn([1, 1], [0, 0], then=then)
        except OSError:
            failed = True
    np.testing.assert_array_equal(teams.state(), before[0])
    np.testing.assert_array_equal(teams.steps, before[1])
