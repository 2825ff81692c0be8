import sys
from pathlib import Path

import minari
import numpy as np
import pytest
from demonstrations import LAYOUT, made_up

from hmi_marl.training.minari_export import export_minari, minari_id


@pytest.fixture(autouse=True)
def own_minari(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    return tmp_path / "minari"


def test_minari_reads_what_was_observed(tmp_path: Path, own_minari: Path) -> None:
    data = made_up([4, 2, 3], driver=[0, -1, 1], names=("lisa", "bart"))
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
        (told,) = dataset.storage.get_episode_metadata([k])
        assert told["seed"] == observed.seeds[k]
        labels.append(told.get("options", {}).get("driver"))
    assert labels == ["lisa", None, "bart"]


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
    monkeypatch.delitem(sys.modules, "hmi_marl.training.minari_export")
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(ModuleNotFoundError, match=r"Minari needs minari: pip install .*\[data\]"):
        import hmi_marl.training.minari_export  # noqa: F401
