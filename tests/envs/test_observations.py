import numpy as np
import pytest

from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import (
    Layout,
    Part,
    driver_layout,
    one_hot,
    state_layout,
    vehicle_ai_layout,
)
from hmi_marl.envs.scene import Scene

TINY = Layout((Part("a", 2, -1.0, 1.0, "first"), Part("b", 1, 0.0, 2.0, "second")))


def test_parts_lie_one_after_another():
    assert TINY.size == 3
    assert TINY["a"] == slice(0, 2)
    assert TINY["b"] == slice(2, 3)
    assert "b" in TINY
    assert "c" not in TINY
    observation = np.array([[1.0, 2.0, 3.0]])
    assert TINY.get(observation, "a").tolist() == [[1.0, 2.0]]
    assert TINY.scalar(observation, "b").tolist() == [3.0]
    with pytest.raises(KeyError, match="no part 'c' in this observation; it has a, b"):
        TINY["c"]


def test_traits_are_also_named_one_by_one():
    layout = driver_layout(TeamConfig())
    last = layout.size - 1  # traits come last
    assert layout["traits"] == slice(last - 3, last + 1)
    assert layout["beta"] == slice(last - 3, last - 2)
    assert layout["inflation"] == slice(last, last + 1)
    assert layout.columns(["inflation", "eta"]).tolist() == [last, last - 1]
    assert list(layout.slices) == [part.name for part in layout.parts]  # no parts of their own
    assert layout.part_with("eta") == "traits"
    assert layout.part_with("speed") == "speed"
    hidden = driver_layout(TeamConfig(observe_traits=False))
    assert "inflation" not in hidden
    with pytest.raises(KeyError, match="no part 'inflation' in this observation; it has lidar"):
        hidden["inflation"]


def test_a_part_that_has_the_name_of_a_column_comes_first():
    layout = Layout((Part("traits", 4, 0.0, 1.0, ""), Part("eta", 2, 0.0, 1.0, "")))
    assert layout["eta"] == slice(4, 6)
    assert layout["alpha"] == slice(1, 2)
    assert layout.part_with("eta") == "eta"


def test_one_hot_there_and_back():
    index = np.array([2, -1, 0])
    assert one_hot(index, 3).tolist() == [[0, 0, 1], [0, 0, 0], [1, 0, 0]]
    layout = Layout((Part("action", 3, 0.0, 1.0, ""),))
    assert layout.chosen(one_hot(index, 3), "action").tolist() == index.tolist()


def test_the_table_names_every_part_and_its_place():
    table = driver_layout(TeamConfig()).table()
    assert "0:32   lidar" in table
    assert "traits" in table


def test_what_is_hidden_is_not_there():
    seen, hidden = TeamConfig(), TeamConfig(ai_sees_attention=False, observe_traits=False)
    for part in ("distracted", "accepted", "counter", "traits"):
        assert part in vehicle_ai_layout(seen)
        assert part not in vehicle_ai_layout(hidden)
        assert part in state_layout(hidden)
    assert "traits" in driver_layout(seen)
    assert "traits" not in driver_layout(hidden)
    assert "distracted" not in driver_layout(seen)
    assert "intended_action" not in driver_layout(seen)


def test_sizes_follow_the_scene():
    config = TeamConfig(scene=Scene(lanes=5, lidar_cells=8, lidar_range=10.0))
    assert driver_layout(config)["lidar"] == slice(0, 16)
    lane = driver_layout(config)["lane"]
    assert lane.stop - lane.start == 6
    assert driver_layout(config).space().high[0] >= 80.0 / 10.0  # closing at twice 40 m/s


def test_the_doctest_of_the_module():
    assert vehicle_ai_layout(TeamConfig(driver="bart"))["distracted"] == slice(58, 59)
