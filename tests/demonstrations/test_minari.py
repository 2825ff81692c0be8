import sys
from pathlib import Path

import minari
import numpy as np
import pytest
from demonstrations import LAYOUT, made_up

from hmi_marl.demonstrations.minari import export_minari, minari_id
from hmi_marl.demonstrations.parquet import read_observed, write_demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect


@pytest.fixture(autouse=True)
def own_minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def test_minari_reads_what_was_observed(tmp_path: Path, own_minari: Path) -> None:
    data = made_up([4, 2, 3], driver=[0, -1, 1], names=("lisa", "bart"))
    assert data.observed.crash_step.tolist() == [-1, -1, -1]
    place = export_minari(data.observed, tmp_path / "my data")
    assert place == own_minari / "hmi_marl-my_data-v0"
    dataset = minari.load_dataset(minari_id(tmp_path / "my data"))
    assert dataset.total_episodes == 3
    assert dataset.total_steps == 3 + 1 + 2
    assert dataset.observation_space == LAYOUT.space()
    assert "random:0.2" in dataset.storage.metadata["description"]
    observed, labels = data.observed, []
    assert observed.seeds is not None
    for k, episode in enumerate(dataset.iterate_episodes()):
        steps = observed.length[k]
        np.testing.assert_array_equal(episode.observations, observed.states[k, :steps])
        np.testing.assert_array_equal(episode.actions, observed.actions[k, : steps - 1])
        np.testing.assert_array_equal(episode.infos["alert"], observed.alerts[k, :steps])
        assert episode.infos.keys() == {"alert"}
        assert not episode.rewards.any()
        assert not episode.terminations.any()
        assert np.flatnonzero(episode.truncations).tolist() == [steps - 2]
        (metadata,) = dataset.storage.get_episode_metadata([k])
        assert metadata["seed"] == observed.seeds[k]
        labels.append(metadata.get("options", {}).get("driver"))
    assert labels == ["lisa", None, "bart"]


def loaded(folder: Path) -> minari.MinariDataset:
    return minari.load_dataset(minari_id(folder))


def test_a_crash_is_a_termination_and_ends_the_episode(tmp_path: Path) -> None:
    # in mid-window, in the step before the last, in the last, in the first, in one step, and never
    data = made_up([5, 5, 5, 5, 1, 5], crash_step=[2, 3, 4, 0, 0, -1]).observed
    export_minari(data, tmp_path / "data")
    actions = [3, 4, 5, 1, 1, 4]
    states = [[0, 1, 2, 3], [0, 1, 2, 3, 4], [0, 1, 2, 3, 4, 4], [0, 1], [0, 0], [0, 1, 2, 3, 4]]
    for k, episode in enumerate(loaded(tmp_path / "data").iterate_episodes()):
        crashed = k != 5
        assert np.flatnonzero(episode.terminations).tolist() == [actions[k] - 1] * crashed
        assert np.flatnonzero(episode.truncations).tolist() == [actions[k] - 1] * (not crashed)
        np.testing.assert_array_equal(episode.actions, data.actions[k, : actions[k]])
        np.testing.assert_array_equal(episode.observations, data.states[k, states[k]])
        np.testing.assert_array_equal(episode.infos["alert"], data.alerts[k, states[k]])


@pytest.mark.parametrize("end_at_crash", [False, True])
def test_a_recovered_environment_plays_the_windows_again(
    tmp_path: Path, end_at_crash: bool
) -> None:
    settings = CollectSettings(
        drivers=("homer", "lisa"),
        steps=60,
        duration=4.0,
        vehicles=(12, 20),
        alert_rate=0.3,
        driver_policy="random",
        end_at_crash=end_at_crash,
        seed=5,
    )
    write_demonstrations(tmp_path / "data", collect(settings))
    observed = read_observed(tmp_path / "data")
    assert 0 < observed.crashed.sum() < len(observed), "both kinds of end"
    export_minari(observed, tmp_path / "data")
    dataset = loaded(tmp_path / "data")
    env = dataset.recover_environment()
    assert env.observation_space == dataset.observation_space == observed.layout.space()
    assert env.action_space == dataset.action_space
    for k, episode in enumerate(dataset.iterate_episodes()):
        (metadata,) = dataset.storage.get_episode_metadata([k])
        seen, _ = env.reset(seed=int(metadata["seed"]), options=metadata["options"])
        np.testing.assert_array_equal(seen, episode.observations[0])
        assert env.unwrapped.team.seed == observed.seeds[k]
        for t, action in enumerate(episode.actions):
            seen, _, terminated, truncated, info = env.step(action)
            assert info["applied_action"] == action
            assert terminated == episode.terminations[t]
            assert not truncated, "the last action of a whole window is not in the data"
            if not terminated:
                np.testing.assert_array_equal(seen, episode.observations[t + 1])
        if episode.truncations[-1]:
            *_, truncated, _ = env.step(int(observed.actions[k, -1]))
            assert truncated == (not observed.crashed[k])
    env.close()


def test_recordings_of_people_have_no_environment(tmp_path: Path) -> None:
    export_minari(made_up([3]).observed, tmp_path / "data")
    with pytest.raises(ValueError, match="Environment cannot be recovered"):
        loaded(tmp_path / "data").recover_environment()


def test_recordings_go_to_the_datasets_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("MINARI_DATASETS_PATH")
    place = export_minari(made_up([3], with_seeds=False).observed, tmp_path / "data")
    assert place == tmp_path / "data" / "minari" / "hmi_marl-data-v0"
    assert place.is_dir()
    with pytest.raises(FileExistsError, match="is there already; remove it"):
        export_minari(made_up([3]).observed, tmp_path / "data")


def test_a_single_step_holds_no_transition(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no transition"):
        export_minari(made_up([3, 1]).observed, tmp_path)


def test_without_minari_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "hmi_marl.demonstrations.minari")
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(ModuleNotFoundError, match=r"Minari needs minari: pip install .*\[data\]"):
        import hmi_marl.demonstrations.minari  # noqa: F401
