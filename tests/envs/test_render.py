import copy
import hashlib
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pygame
import pytest
from numpy.typing import NDArray

from hmi_marl.agents.partners import merge_hmi
from hmi_marl.envs import merge_v0
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.render import (
    AMBER,
    BLUE,
    GREY,
    LIGHT,
    PANEL_HEIGHT,
    TeamStatus,
    Viewer,
    between,
    has_display,
    team_status,
)
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.single import SingleTeam
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import Snapshot

CONFIG = TeamConfig(duration=2.0, scene=Scene(vehicles=2))
STATUS = TeamStatus(
    driver="homer",
    inflation=9.0,
    distracted=False,
    alert=False,
    steps_left=0,
    window=7,
    intended="keep_speed",
    applied="keep_speed",
    speed=30.0,
    time=0.4,
    crashed=False,
)
SNAPSHOT = Snapshot(
    time=0.4,
    position=np.array([[100.0, 8.0], [120.0, 4.0], [150.0, 18.5]]),
    heading=np.array([0.0, 0.02, 0.0]),
    speed=np.array([30.0, 28.0, 20.0]),
    crashed=np.zeros(3, np.bool_),
    obstacles=np.array([[170.0, 12.0]]),
)
Picture = NDArray[np.uint8]


@pytest.fixture(scope="module")
def viewer() -> Viewer:
    return Viewer(CONFIG)


@pytest.fixture(scope="module")
def plain(viewer: Viewer) -> Picture:
    return viewer.draw(SNAPSHOT, STATUS)


@pytest.fixture
def pretended_display(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """SDL's dummy driver, and a display by name only."""
    pygame.display.quit()
    monkeypatch.setenv("DISPLAY", ":99")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    yield
    pygame.display.quit()


def road(picture: Picture) -> Picture:
    return picture[:-PANEL_HEIGHT]


def panel(picture: Picture) -> Picture:
    return picture[-PANEL_HEIGHT:]


def differ(one: Picture, other: Picture) -> bool:
    return bool((one != other).any())


def test_a_picture_is_rgb_of_the_width_asked_for(plain: Picture) -> None:
    # (three lanes of 4 m and 16 m around them) x 5.5 pixels, and the panel
    assert plain.shape == (28 * 5.5 + PANEL_HEIGHT, 880, 3)
    assert plain.dtype == np.uint8
    narrow = Viewer(CONFIG, width=641).draw(SNAPSHOT, STATUS)
    assert narrow.shape == (plain.shape[0], 640, 3), "video wants even numbers"


def test_more_lanes_make_a_higher_picture(plain: Picture) -> None:
    config = TeamConfig(duration=2.0, scene=Scene(lanes=5, vehicles=2))
    assert Viewer(config).draw(SNAPSHOT, STATUS).shape[0] == plain.shape[0] + 2 * 4 * 5.5


def test_pictures_are_not_black(plain: Picture) -> None:
    assert road(plain).mean() > 60
    assert panel(plain).mean() > 200
    assert len(np.unique(road(plain).reshape(-1, 3), axis=0)) > 4, "road, lines and two cars"


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.parametrize("driver", ["dummy", "offscreen", None])
def test_pictures_do_not_depend_on_sdls_driver(driver: str | None, plain: Picture) -> None:
    script = (
        "import hashlib; from test_render import *;"
        "print(hashlib.sha256(Viewer(CONFIG).draw(SNAPSHOT, STATUS).tobytes()).hexdigest())"
    )
    unwanted = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    surroundings = {name: value for name, value in os.environ.items() if name not in unwanted}
    surroundings["PYTHONPATH"] = os.path.dirname(__file__)
    if driver is not None:
        surroundings["SDL_VIDEODRIVER"] = driver
    drawn = subprocess.run(
        [sys.executable, "-c", script], env=surroundings, capture_output=True, text=True, check=True
    )
    assert drawn.stdout.split()[-1] == hashlib.sha256(plain.tobytes()).hexdigest()


def test_the_same_moment_is_drawn_the_same(viewer: Viewer, plain: Picture) -> None:
    viewer.draw(replace(SNAPSHOT, position=SNAPSHOT.position + 50.0), replace(STATUS, alert=True))
    np.testing.assert_array_equal(viewer.draw(SNAPSHOT, STATUS), plain)


def test_a_picture_is_kept_when_the_next_is_drawn(viewer: Viewer) -> None:
    first = viewer.draw(SNAPSHOT, STATUS)
    kept = first.copy()
    viewer.draw(SNAPSHOT, replace(STATUS, distracted=True, alert=True))
    np.testing.assert_array_equal(first, kept)


def test_a_distracted_drivers_car_and_panel_look_different(viewer: Viewer, plain: Picture) -> None:
    distracted = viewer.draw(SNAPSHOT, replace(STATUS, distracted=True))
    assert differ(road(distracted), road(plain))
    assert differ(panel(distracted), panel(plain))


def test_a_crash_shows_on_the_road_and_in_the_panel(viewer: Viewer, plain: Picture) -> None:
    crashed = replace(SNAPSHOT, crashed=np.array([True, False, False]))
    picture = viewer.draw(crashed, replace(STATUS, crashed=True))
    assert differ(road(picture), road(plain))
    assert differ(panel(picture), panel(plain))
    other = viewer.draw(replace(SNAPSHOT, crashed=np.array([False, True, False])), STATUS)
    assert differ(road(other), road(plain))
    assert not differ(panel(other), panel(plain))


@pytest.mark.parametrize(
    "change",
    [
        {"alert": True},
        {"steps_left": 3},
        {"window": 4},
        {"intended": "move_left"},
        {"applied": "slow_down"},
        {"driver": "bart"},
        {"time": 1.0},
        {"speed": 20.0},
    ],
)
def test_the_panel_shows_it_and_the_road_does_not(
    viewer: Viewer, plain: Picture, change: dict[str, object]
) -> None:
    picture = viewer.draw(SNAPSHOT, replace(STATUS, **change))
    assert differ(panel(picture), panel(plain))
    assert not differ(road(picture), road(plain))


@pytest.mark.parametrize("steps_left", [0, 1, 6, 7])
def test_the_panel_has_a_blue_cell_for_each_step_left(viewer: Viewer, steps_left: int) -> None:
    picture = viewer.draw(SNAPSHOT, replace(STATUS, steps_left=steps_left))
    blue = (panel(picture) == BLUE).all(axis=2)
    assert blue.sum() == steps_left * 12 * 13


def test_vehicles_are_drawn_where_they_are(viewer: Viewer, plain: Picture) -> None:
    moved = SNAPSHOT.position + np.array([[0, 0], [10.0, 0], [0, 0]])
    picture = viewer.draw(replace(SNAPSHOT, position=moved), STATUS)
    changed = np.flatnonzero((road(picture) != road(plain)).any(axis=(0, 2)))
    # the car was 20 m ahead of the driver's, who is at 35 % of the width, and now is 30 m ahead
    ahead = (changed - 0.35 * 880) / 5.5
    assert 20 - 3.5 < ahead.min() < 20
    assert 30 < ahead.max() < 30 + 3.5


def test_perceived_sizes_are_drawn_when_asked_for(plain: Picture) -> None:
    perceived = Viewer(CONFIG, perceived=True)
    drawn = perceived.draw(SNAPSHOT, STATUS)
    assert differ(road(drawn), road(plain))
    larger = (road(drawn) != road(plain)).any(axis=2).sum()
    smaller = perceived.draw(SNAPSHOT, replace(STATUS, inflation=3.0))
    assert (road(smaller) != road(plain)).any(axis=2).sum() < larger


def ghost(inflation: float, heading: float = 0.0) -> tuple[NDArray[np.float64], ...]:
    """Where, from the middle of the one other car [m], its perceived size changes the picture."""
    two = replace(
        SNAPSHOT,
        position=np.array([[100.0, 8.0], [125.0, 8.0]]),
        heading=np.array([0.0, heading]),
        speed=np.full(2, 30.0),
        crashed=np.zeros(2, np.bool_),
        obstacles=np.zeros((0, 2)),
    )
    status = replace(STATUS, inflation=inflation)
    drawn = [road(Viewer(CONFIG, perceived=p).draw(two, status)) for p in (True, False)]
    down, right = np.nonzero((drawn[0] != drawn[1]).any(axis=2))
    return right / 5.5 - (0.35 * 880 / 5.5 + 25.0), down / 5.5 - 14.0


def test_a_perceived_size_is_the_true_one_times_the_inflation() -> None:
    along, across = ghost(inflation=3.0)
    # a car of 5 m x 2 m
    for extent, size in ((along, 15.0), (across, 6.0)):
        assert extent.max() - extent.min() == pytest.approx(size, abs=0.5)
        assert extent.max() + extent.min() == pytest.approx(0.0, abs=0.5)


def test_a_perceived_size_turns_with_the_car() -> None:
    # a positive heading is to the right of the road, down in the picture
    along, across = ghost(inflation=3.0, heading=0.5)
    assert np.corrcoef(along, across)[0, 1] > 0.5
    area = len(along) / 5.5**2
    assert area == pytest.approx(15.0 * 6.0, rel=0.05), "turned, not sheared"


def test_perceived_sizes_without_inflation_are_the_true_ones(plain: Picture) -> None:
    picture = Viewer(CONFIG, perceived=True).draw(SNAPSHOT, replace(STATUS, inflation=1.0))
    np.testing.assert_array_equal(road(picture), road(plain))


def test_inflation_does_not_show_when_not_asked_for(viewer: Viewer, plain: Picture) -> None:
    np.testing.assert_array_equal(viewer.draw(SNAPSHOT, replace(STATUS, inflation=3.0)), plain)


def test_a_window_without_a_display_is_refused_with_advice(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", "")))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RuntimeError, match=r"no display .* --out clip\.gif, or render_mode="):
        Viewer(CONFIG, window=True)
    assert Viewer(CONFIG).draw(SNAPSHOT, STATUS).any(), "pictures need none"


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_either_kind_of_display_will_do(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.setattr(os, "uname", lambda: os.uname_result(("Linux", "", "", "", "")))
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert not has_display()
    monkeypatch.setenv(name, ":0")
    assert has_display()


def shown(viewer: Viewer) -> Picture:
    assert viewer._window is not None
    return np.moveaxis(pygame.surfarray.array3d(viewer._window.get_surface()), 0, 1)


@pytest.mark.usefixtures("pretended_display")
def test_a_window_shows_the_picture_that_is_returned(plain: Picture) -> None:
    window = Viewer(CONFIG, window=True)
    picture = window.draw(SNAPSHOT, STATUS, frames=50)
    np.testing.assert_array_equal(shown(window), plain)
    np.testing.assert_array_equal(picture, plain)
    assert not window.closed
    window.close()
    assert window.closed
    np.testing.assert_array_equal(window.draw(SNAPSHOT, STATUS, frames=50), plain)
    assert window.closed, "it does not open again"


@pytest.mark.usefixtures("pretended_display")
def test_closing_one_viewer_leaves_the_others_usable(plain: Picture) -> None:
    pictures, window, other = Viewer(CONFIG), *(Viewer(CONFIG, window=True) for _ in range(2))
    window.draw(SNAPSHOT, STATUS, frames=50)
    window.close()
    window.close()  # once more does no harm
    np.testing.assert_array_equal(pictures.draw(SNAPSHOT, STATUS), plain)
    other.draw(SNAPSHOT, STATUS, frames=50)
    np.testing.assert_array_equal(shown(other), plain)
    pictures.close()
    np.testing.assert_array_equal(Viewer(CONFIG).draw(SNAPSHOT, STATUS), plain)
    other.close()


@pytest.mark.usefixtures("pretended_display")
@pytest.mark.parametrize("begun_again", [False, True])
def test_another_environment_may_quit_pygame(plain: Picture, begun_again: bool) -> None:
    # as highway-env's viewer does when its environment is closed
    pictures, window = Viewer(CONFIG), Viewer(CONFIG, window=True)
    for _ in range(2):
        pygame.quit()
        if begun_again:
            pygame.display.init()
            pygame.font.init()
        np.testing.assert_array_equal(pictures.draw(SNAPSHOT, STATUS), plain)
        window.draw(SNAPSHOT, STATUS, frames=50)
        np.testing.assert_array_equal(shown(window), plain)
    pygame.quit()
    window.close()


@pytest.mark.usefixtures("pretended_display")
def test_a_close_button_closes_its_own_window_whoever_draws(plain: Picture) -> None:
    one, other = (Viewer(CONFIG, window=True) for _ in range(2))
    pygame.event.get()
    pygame.event.post(pygame.Event(pygame.WINDOWCLOSE, window=one._window))
    other.draw(SNAPSHOT, STATUS, frames=50)
    assert one.closed
    assert not other.closed
    pygame.event.post(pygame.Event(pygame.QUIT))
    other.draw(SNAPSHOT, STATUS, frames=50)
    assert other.closed


@pytest.mark.usefixtures("pretended_display")
def test_an_environment_goes_on_when_its_window_is_closed() -> None:
    team = SingleTeam(CONFIG, "highway", "human")
    team.reset(seed=1)
    pygame.event.post(pygame.Event(pygame.QUIT))
    for _ in range(3):
        team.result = team.teaming.turn([1], [0])
        team.show()
    assert team._viewer is not None
    assert team._viewer.closed
    team.close()
    team.reset(seed=1)
    assert team._viewer is not None
    assert not team._viewer.closed, "close() and reset() open another"
    team.close()


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))], ids=["copy", "pickle"]
)
@pytest.mark.parametrize("make", [merge_v0.env, merge_v0.parallel_env, merge_hmi])
def test_an_environment_that_was_drawn_can_be_copied(
    make: Callable[..., Any], copied: Callable[[Any], Any]
) -> None:
    env = make(driver="homer", duration=2.0, scene=Scene(vehicles=2), render_mode="rgb_array")
    env.reset(seed=1)
    picture = env.render()
    again = copied(env)
    np.testing.assert_array_equal(again.render(), picture)
    np.testing.assert_array_equal(env.render(), picture)
    env.close()
    again.close()


def test_between_goes_straight_from_one_moment_to_the_next() -> None:
    after = replace(
        SNAPSHOT,
        time=0.6,
        position=SNAPSHOT.position + np.array([6.0, 0.4]),
        heading=SNAPSHOT.heading + 0.1,
        speed=SNAPSHOT.speed - 2.0,
        crashed=np.array([True, False, False]),
    )
    quarter = between(SNAPSHOT, after, 0.25)
    assert quarter.time == pytest.approx(0.45)
    np.testing.assert_allclose(quarter.position, SNAPSHOT.position + np.array([1.5, 0.1]))
    np.testing.assert_allclose(quarter.heading, SNAPSHOT.heading + 0.025)
    np.testing.assert_allclose(quarter.speed, SNAPSHOT.speed - 0.5)
    assert not quarter.crashed.any()
    assert between(SNAPSHOT, after, 0.75).crashed.tolist() == [True, False, False]
    for fraction, end in ((0.0, SNAPSHOT), (1.0, after)):
        reached = between(SNAPSHOT, after, fraction)
        for name, value in vars(end).items():
            np.testing.assert_array_equal(getattr(reached, name), value, err_msg=name)


def test_between_moments_with_other_vehicles_is_the_later_one() -> None:
    fewer = replace(
        SNAPSHOT,
        position=SNAPSHOT.position[:2],
        heading=SNAPSHOT.heading[:2],
        speed=SNAPSHOT.speed[:2],
        crashed=SNAPSHOT.crashed[:2],
    )
    assert between(SNAPSHOT, fewer, 0.1) is fewer


@pytest.fixture
def alert_window() -> int:
    return 3


@pytest.fixture
def teaming(alert_window: int) -> Teaming:
    config = TeamConfig(
        driver=["homer", "bart"], alert_window=alert_window, duration=2.0, scene=Scene(vehicles=1)
    )
    made = Teaming(config, 2)
    made.reset(np.array([1, 2], np.uint64))
    return made


def test_the_status_counts_an_alerts_window_down(teaming: Teaming, alert_window: int) -> None:
    assert team_status(teaming, 0).steps_left == 0
    left, alerts, accepted = [], [], []
    for alert in (0, 1, 0, 0, 0, 1, 0, 1, 0):
        teaming.intend([1, 1])
        teaming.step([alert, 0])
        status = team_status(teaming, 0)
        left.append(status.steps_left)
        alerts.append(status.alert)
        accepted.append(bool(teaming.attention.accepted[0]))
        assert team_status(teaming, 1).steps_left == 0, "the other team was never alerted"
    assert status.window == alert_window
    assert left == [0, 3, 2, 1, 0, 3, 2, 3, 2]
    assert alerts == [False, True, False, False, False, True, False, True, False]
    assert accepted == [steps > 0 for steps in left]


def test_the_status_is_the_teams_own(teaming: Teaming) -> None:
    first = team_status(teaming, 1)
    assert (first.intended, first.applied, first.time, first.speed) == ("-", "-", 0.0, 30.0)
    teaming.intend([1, 0])
    teaming.step([0, 1])
    teaming.intend([1, 4])
    teaming.step([0, 1])
    one, other = team_status(teaming, 0), team_status(teaming, 1)
    assert other.intended == "slow_down"
    assert other.applied == ("move_left" if other.distracted else "slow_down")
    assert (one.intended, one.applied) == ("keep_speed", "keep_speed")
    assert (one.alert, other.alert) == (False, True)
    assert one.time == other.time == pytest.approx(0.4)
    for k, status in enumerate((one, other)):
        assert status.distracted == bool(teaming.attention.distracted[k])
        assert status.speed == teaming.ego.speed[k]
        assert status.inflation == teaming.traits.inflation[k]
        assert status.driver == {9.0: "homer", 3.0: "bart"}[status.inflation]


def test_the_status_holds_the_intent_and_the_action_of_the_same_step(teaming: Teaming) -> None:
    teaming.intend([1, 1])
    assert team_status(teaming, 0).intended == "-", "no step is complete yet"
    teaming.step([0, 0])
    complete = team_status(teaming, 0)
    assert (complete.intended, complete.applied) == ("keep_speed", "keep_speed")
    teaming.intend([4, 4])
    assert team_status(teaming, 0) == complete
    teaming.step([0, 0])
    assert team_status(teaming, 0).intended == "slow_down"


def test_a_driver_of_no_name_is_called_driver() -> None:
    from hmi_marl import Driver

    stranger = Driver("moe", beta=0.3, alpha=0.3, eta=0.3, inflation=2.0)
    made = Teaming(TeamConfig(driver=stranger, duration=2.0, scene=Scene(vehicles=1)), 1)
    made.reset(np.array([1], np.uint64))
    assert team_status(made, 0).driver == "driver"


def test_the_status_shows_the_strength_of_an_alert() -> None:
    made = Teaming(
        TeamConfig(duration=2.0, scene=Scene(vehicles=1), alert_strengths=(0.25, 0.5, 1.0)), 1
    )
    made.reset(np.array([1], np.uint64))
    shown = []
    for alert in (2, 0, 3):
        made.intend([1])
        made.step([alert])
        status = team_status(made, 0)
        shown.append((status.alert, status.strength if status.alert else None, status.steps_left))
    assert shown == [(True, 0.5, 7), (False, None, 6), (True, 1.0, 7)]


def bars(picture: Picture, colour: tuple[int, int, int]) -> list[int]:
    """Lengths of the belief's bars of this colour [pixels], from above."""
    place = (panel(picture)[:, 770:866] == colour).all(axis=2)
    rows = place.any(axis=1).astype(int)
    tops = np.flatnonzero(np.diff(rows, prepend=0) == 1)
    return [int(place[top].sum()) for top in tops]


def test_the_panel_shows_what_is_believed_and_the_road_does_not(
    viewer: Viewer, plain: Picture
) -> None:
    belief = (("lisa", 0.25), ("marge", 0.0), ("bart", 0.5), ("homer", 0.25))
    picture = viewer.draw(SNAPSHOT, replace(STATUS, belief=belief))
    assert not differ(road(picture), road(plain))
    assert not differ(panel(picture)[:, :690], panel(plain)[:, :690])
    assert bars(picture, BLUE) == [48], "the likeliest"
    assert bars(picture, GREY) == [24, 24]
    assert bars(picture, LIGHT) == [72, 96, 48, 72]
    again = viewer.draw(SNAPSHOT, STATUS)
    np.testing.assert_array_equal(again, plain)


def test_of_many_candidates_the_likeliest_are_shown_in_their_order(viewer: Viewer) -> None:
    belief = tuple((f"d-{k}", p) for k, p in enumerate((0.0, 0.125, 0.25, 0.0, 0.5, 0.0, 0.125)))
    picture = viewer.draw(SNAPSHOT, replace(STATUS, belief=belief))
    assert bars(picture, BLUE) == [48]
    assert bars(picture, GREY) == [12, 24, 12]
    chosen = tuple(entry for entry in belief if entry[1] > 0)
    np.testing.assert_array_equal(viewer.draw(SNAPSHOT, replace(STATUS, belief=chosen)), picture)


def test_a_belief_and_perceived_sizes_have_room_next_to_each_other() -> None:
    perceived = Viewer(CONFIG, perceived=True)
    believed = replace(STATUS, belief=(("bart", 0.5), ("lisa", 0.5)))
    pictures = [
        perceived.draw(SNAPSHOT, replace(believed, inflation=inflation)) for inflation in (3.0, 9.0)
    ]
    assert differ(panel(pictures[0])[:, :180], panel(pictures[1])[:, :180])
    assert not differ(panel(pictures[0])[:, 690:], panel(pictures[1])[:, 690:])
    assert bars(pictures[0], BLUE) == [48], "the first of equals"


def test_the_panel_shows_whether_the_driver_reveals_d_and_the_belief_in_it(
    viewer: Viewer, plain: Picture
) -> None:
    silent, shown = (
        viewer.draw(SNAPSHOT, replace(STATUS, reveals=reveals, distracted_belief=belief))
        for reveals, belief in ((False, 0.25), (True, 1.0))
    )
    for picture, length in ((silent, 24), (shown, 96)):
        assert not differ(road(picture), road(plain))
        assert not differ(panel(picture)[:, :690], panel(plain)[:, :690])
        bar = (panel(picture)[44:60, 770:866] == AMBER).all(axis=2)
        assert bar.sum(axis=1).max() == length
    badges = panel(silent)[10:36, 690:816], panel(shown)[10:36, 690:816]
    assert not (badges[0] == BLUE).all(axis=2).any()
    assert (badges[1] == BLUE).all(axis=2).mean() > 0.5


def test_a_belief_about_d_and_perceived_sizes_have_room_next_to_each_other() -> None:
    perceived = Viewer(CONFIG, perceived=True)
    hidden = replace(STATUS, distracted_belief=0.5)
    pictures = [
        perceived.draw(SNAPSHOT, replace(hidden, inflation=inflation)) for inflation in (3.0, 9.0)
    ]
    assert differ(panel(pictures[0])[:, :180], panel(pictures[1])[:, :180])
    assert not differ(panel(pictures[0])[:, 690:], panel(pictures[1])[:, 690:])
