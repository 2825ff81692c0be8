from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.scene import Scene
from hmi_marl.reporting import clip, highlight
from hmi_marl.reporting.highlight import (
    HOLD,
    Beat,
    Highlight,
    best_seed,
    best_step,
    caption,
    cut,
    held_moments,
    record,
    what_is_missing,
)

WINDOW, FREQUENCY = 7, 5.0


def beats(
    attention: str, alerts: str, others: int | list[int] = 3, overridden: str = ""
) -> tuple[Beat, ...]:
    """An episode: D where distracted and A where an alert is given, a letter for each moment."""
    counts = [others] * len(attention) if isinstance(others, int) else others
    return tuple(
        Beat(
            distracted=d == "D",
            alert=a == "A",
            overridden=overridden[k : k + 1] == "X",
            others=count,
            crashed=False,
        )
        for k, (d, a, count) in enumerate(zip(attention, alerts, counts, strict=True))
    )


def seconds(found: Highlight) -> list[float]:
    return [k / FREQUENCY for k in range(len(found.beats))]


def test_the_step_shown_is_an_alert_that_works_amid_traffic() -> None:
    #                         0123456789
    found = best_step(beats("..D.....D.", "...A.A...A", [0, 0, 0, 0, 2, 2, 2, 2, 2, 2]), WINDOW)
    assert found.step == 9, "the alert of step 3 works as well, but without traffic"
    assert found.complete
    found = best_step(beats("..DD.....", "...AA...."), WINDOW)
    assert found.step == 4, "the alert of step 3 leaves the driver distracted"
    assert found.since == 2
    assert found.alerts == 2


def test_of_two_that_work_the_longer_lasting_is_shown_then_the_one_that_mattered() -> None:
    assert best_step(beats("..D.DD...", "...A..A.."), WINDOW).step == 6
    same = "..D...D...", "...A...A.."
    assert best_step(beats(*same), WINDOW).step == 3, "the first of equals"
    assert best_step(beats(*same, overridden="......X..."), WINDOW).step == 7


@pytest.mark.parametrize(
    ("attention", "alerts", "others", "step"),
    [
        ("..D..", ".....", 3, 3),  # a distraction without an alert
        ("..DD.", "...A.", 3, 3),  # an alert that does not work
        (".....", "..A..", 3, 1),  # nobody was distracted
        ("..D..", "...A.", 0, 3),  # no traffic
        (".", ".", 3, 0),  # an episode that has not begun
    ],
)
def test_where_something_is_missing_the_best_is_shown_and_it_is_told(
    attention: str, alerts: str, others: int, step: int
) -> None:
    found = best_step(beats(attention, alerts, others), WINDOW)
    assert found.step == step
    assert not found.complete
    assert what_is_missing(found, 12).startswith("None of the 12 episodes searched shows traffic,")


def test_the_caption_says_what_is_to_be_seen_and_when() -> None:
    found = best_step(beats("...DD....D", "....AA....", overridden="...X......"), WINDOW)
    text = caption(found, "homer", seconds(found), range(10))
    assert text == (
        "0.0 to 1.8 s, 3 other cars in the picture: homer is distracted at 0.6 s (amber); the HMI "
        "alerts (red) 2 times, the last at 1.0 s, and homer is attentive again (green) until "
        "1.8 s. The clip stands still at both moments."
    )
    assert what_is_missing(found, 12) == ""
    one = best_step(beats("..D..", "...A.", 1, "..X.."), WINDOW)
    text = caption(one, "homer", seconds(one), range(5))
    assert "1 other car in" in text
    assert "the car repeats its last action instead of the intended one" in text
    assert "the HMI alerts (red) at 0.6 s, and homer is attentive again (green) to the end" in text


def test_a_caption_claims_nothing_that_is_not_there() -> None:
    ignored = best_step(beats("..DDD", "...A."), WINDOW)
    text = caption(ignored, "bart", seconds(ignored), range(5))
    assert "but bart stays distracted" in text
    assert "attentive again" not in text
    silent = best_step(beats("..DDD", ".....", 0), WINDOW)
    text = caption(silent, "bart", seconds(silent), range(5))
    assert "no traffic" in text
    assert "no alert comes" in text
    assert "stands still" not in text
    calm = best_step(beats(".....", "....."), WINDOW)
    assert "bart is attentive" in caption(calm, "bart", seconds(calm), range(5))


@pytest.mark.parametrize("step", [3, 30, 50, 98])
def test_the_cut_lies_within_the_episode_around_the_step(step: int) -> None:
    attention = ["."] * 101
    attention[step - 1] = "D"
    alerts = ["."] * 101
    alerts[step] = "A"
    found = best_step(beats("".join(attention), "".join(alerts)), WINDOW)
    assert found.step == step
    shown = cut(found, FREQUENCY)
    assert 0 <= shown[0] < step < shown[-1] <= 100 or step in shown
    assert len(shown) == 5 * (highlight.LEAD_IN + highlight.LEAD_OUT) + 1
    assert held_moments(found) == (step - 1, step)
    assert set(held_moments(found)) <= set(shown)


def test_a_short_episode_is_shown_whole() -> None:
    found = best_step(beats("..D..", "...A."), WINDOW)
    assert cut(found, FREQUENCY) == range(5)


CONFIG = TeamConfig(driver="homer", duration=4.0, scene=Scene(vehicles=(1, 12)))


def test_a_clip_of_an_hmi_that_works_shows_all_three(tmp_path: Path) -> None:
    path = tmp_path / "clip.gif"
    counts: list[int] = []

    def progress(pictures: clip.Pictures, count: int) -> clip.Pictures:
        counts.append(count)
        return pictures

    told = record(path, CONFIG, "optimal", "rule", range(20), 2, progress)
    assert "None of" not in told
    assert "the HMI alerts (red)" in told
    assert "homer is attentive again (green)" in told
    assert "other car" in told
    with Image.open(path) as image:
        pauses = [frame.info["duration"] for frame in ImageSequence.Iterator(image)]
    assert counts == [len(pauses)]
    assert pauses.count(round(1000 * HOLD)) == 2
    assert record(tmp_path / "again.gif", CONFIG, "optimal", "rule", range(20), 2) == told
    assert (tmp_path / "again.gif").read_bytes() == path.read_bytes()


def test_the_caption_is_true_of_the_episode_on_highway_env() -> None:
    seed = best_seed(CONFIG, "optimal", "rule", range(20))
    moments = list(clip.episode(CONFIG, "optimal", "rule", seed))
    found = best_step([Beat.of(*moment) for moment in moments], CONFIG.alert_window)
    before, now = moments[found.step - 1][1], moments[found.step][1]
    assert before.distracted
    assert now.alert
    assert not now.distracted
    ahead = moments[found.step][0].position[1:, 0] - moments[found.step][0].position[0, 0]
    assert np.sum((ahead > -50) & (ahead < 95)) == found.now.others > 0


def test_an_hmi_that_never_alerts_is_told_so(tmp_path: Path) -> None:
    told = record(tmp_path / "clip.gif", CONFIG, "never", "rule", range(5), 1)
    assert "None of the 5 episodes searched shows traffic, a distraction and an alert that" in told
    assert "no alert comes" in told


def test_no_more_seeds_are_searched_than_is_cheap(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(highlight, "MOST_SEEDS", 2)
    assert best_seed(CONFIG, "optimal", "rule", range(7, 1000)) in (7, 8)
