"""TorchRL: GymEnv for a seat, PettingZooWrapper for both, also in one group."""

from typing import Any

import pytest
from fresh import run_example

pytest.importorskip("torchrl")

import hmi_marl  # noqa: F401
from hmi_marl import merge_v0

pytestmark = pytest.mark.filterwarnings("default")  # it warns of any PettingZoo after 1.24
SETTINGS = {"driver": "homer", "world": "batched", "duration": 2.0}
SEATS = {"MergeDriver": 5, "MergeHMI": 2}


@pytest.mark.parametrize("categorical", [True, False])
@pytest.mark.parametrize("seat", SEATS)
def test_a_seat_as_a_gym_env(seat: str, categorical: bool) -> None:
    from torchrl.envs import GymEnv
    from torchrl.envs.utils import check_env_specs

    env = GymEnv(f"hmi_marl/{seat}-v0", categorical_action_encoding=categorical, **SETTINGS)
    check_env_specs(env)
    rollout = env.rollout(30, break_when_any_done=False)
    assert rollout["action"].shape == ((30,) if categorical else (30, SEATS[seat]))
    ends = rollout["next", "terminated"] | rollout["next", "truncated"]
    assert (rollout["next", "done"] == ends).all()
    assert ends.sum() >= 2
    firsts = []
    for _ in range(2):
        env.set_seed(3)
        firsts.append(env.reset()["observation"])
    assert (firsts[0] == firsts[1]).all()


def test_frames_are_skipped_by_torchrl_and_pictures_are_drawn() -> None:
    from torchrl.envs import GymEnv

    env = GymEnv("hmi_marl/MergeHMI-v0", frame_skip=2, **SETTINGS)
    assert len(env.rollout(50)) <= 5
    env = GymEnv("hmi_marl/MergeHMI-v0", from_pixels=True, pixels_only=False, **SETTINGS)
    pixels = env.rollout(2)["pixels"]
    assert pixels.shape[-1] == 3
    assert pixels.float().std() > 10


def test_an_unknown_keyword_is_still_refused() -> None:
    from torchrl.envs import GymEnv

    with pytest.raises(TypeError, match="unexpected keyword argument 'drvier'; it takes"):
        GymEnv("hmi_marl/MergeHMI-v0", drvier="bart")


@pytest.mark.parametrize("options", [{}, {"return_state": True}, {"categorical_actions": False}])
@pytest.mark.parametrize("turns", [False, True])
def test_both_seats_in_a_group_each(turns: bool, options: dict[str, Any]) -> None:
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    make = merge_v0.env if turns else merge_v0.parallel_env
    env = PettingZooWrapper(make(**SETTINGS), use_mask=turns, **options)
    assert env.group_map == {"driver": ["driver"], "vehicle_ai": ["vehicle_ai"]}
    check_env_specs(env)
    rollout = env.rollout(40, break_when_any_done=False)
    if turns:
        assert (rollout["driver", "mask"] ^ rollout["vehicle_ai", "mask"]).any()
    if "return_state" in options:
        assert rollout["state"].shape == (40, *make(**SETTINGS).unwrapped.state_space.shape)


@pytest.mark.parametrize("turns", [False, True])
def test_both_seats_in_one_group(turns: bool) -> None:
    from torchrl.envs import PettingZooWrapper
    from torchrl.envs.utils import check_env_specs

    supersuit = pytest.importorskip("supersuit")
    make = merge_v0.env if turns else merge_v0.parallel_env
    padded = supersuit.pad_action_space_v0(supersuit.pad_observations_v0(make(**SETTINGS)))
    group = {"car": ["driver", "vehicle_ai"]}
    env = PettingZooWrapper(padded, group_map=group, use_mask=turns)
    check_env_specs(env)
    rollout = env.rollout(40, break_when_any_done=False)
    assert rollout["car", "observation"].shape == (40, 2, 65)
    assert rollout["car", "action"].shape == (40, 2)
    unpadded = PettingZooWrapper(make(**SETTINGS), group_map=group, use_mask=turns)
    with pytest.raises(RuntimeError, match="stack"):  # which is why they are padded
        read(unpadded, "car", "observation")


def read(env: Any, *key: str) -> Any:
    return env.rollout(3)[key]


@pytest.mark.parametrize("world", ["highway", "batched"])
def test_the_example_learns(world: str) -> None:
    size = ["--steps", "20", "--batches", "2", "--duration", "2"]
    printed = run_example("torchrl_groups", "--world", world, *size)
    assert printed.count("reward of a step") == 2
