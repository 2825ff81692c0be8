import json
from pathlib import Path

import pytest
from evidence_models import save_trained, trait_model
from model_cards import with_card
from stages import Counting
from trait_models import save_driver, untrained

from hmi_marl.agents.learned.cards import INDEX, INDEX_FORMAT, find_shipped, shipped_agents
from hmi_marl.agents.learned.policy import load_policy
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.demonstrations.dataset import observed_layout
from hmi_marl.envs.config import TeamConfig
from hmi_marl.experiments.experiment import Agent
from hmi_marl.files import with_checksum, write_json
from hmi_marl.reproduction.shipping import ship, ship_more, without_places
from hmi_marl.reproduction.suite import run_suite


class Learning(Counting):
    """It has learned a driver."""

    def agents(self, place):
        return [Agent("mine", place.folder / "driver.json", "drives")]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    card = save_driver(folder / "one") / "driver.json"
    about = {"command": f"hmi-marl train --out {folder}/one", "settings": {"path": str(folder)}}
    with_card(card, training=about)
    return folder


def test_what_was_learned_is_shipped_without_places(run: Path, tmp_path: Path) -> None:
    stages, out = [Learning("one")], tmp_path / "trained"
    with pytest.raises(ValueError, match=r"stage one of .* is not finished"):
        ship(stages, run, run, out)
    run_suite(stages, run, run, line=str)
    assert [agent.name for agent in ship(stages, run, run, out)] == ["mine"]
    card = find_shipped("trained:mine", "driver", out)
    assert str(tmp_path) not in card.read_text()
    training = json.loads(card.read_text())["training"]
    assert training == {"command": "hmi-marl train --out one", "settings": {"path": "run"}}
    load_policy(card, "driver", TeamConfig())
    # Once more, in place of what was there.
    (out / "old").mkdir()
    ship(stages, run, run, out)
    assert sorted(path.name for path in out.iterdir()) == [INDEX, "mine"]
    assert list(shipped_agents(out)) == ["mine"]


def test_weights_that_changed_since_are_not_shipped(run: Path, tmp_path: Path) -> None:
    stages = [Learning("one")]
    run_suite(stages, run, run, line=str)
    save_driver(run / "one", 3)
    with pytest.raises(ValueError, match="is not finished"):
        ship(stages, run, run, tmp_path / "trained")


def test_a_card_that_changed_since_is_not_shipped(run: Path, tmp_path: Path) -> None:
    stages = [Learning("one")]
    run_suite(stages, run, run, line=str)
    card = run / "one" / "driver.json"
    card.write_text(card.read_text().replace('"by_intent": false', '"by_intent": true'))
    with pytest.raises(ValueError, match=r"driver\.json is damaged: its checksum differs; run its"):
        ship(stages, run, run, tmp_path / "trained")
    assert not (tmp_path / "trained").exists()


def test_a_folder_of_other_things_is_left_alone(run: Path, tmp_path: Path) -> None:
    (tmp_path / "precious").mkdir()
    (tmp_path / "precious" / "thesis.txt").touch()
    with pytest.raises(ValueError, match="holds other things than shipped agents"):
        ship([Learning("one")], run, run, tmp_path / "precious")
    assert (tmp_path / "precious" / "thesis.txt").is_file()


def test_places_keep_their_last_part_alone() -> None:
    told = {"a": ["do --out /x/y/z --driver-run=/x/y/ 1/2 s", 3, None], "b": "C:\\x\\y", "c": "~/x"}
    assert without_places(told) == {
        "a": ["do --out z --driver-run=y 1/2 s", 3, None],
        "b": "y",
        "c": "x",
    }


def test_more_agents_are_added_to_those_that_are_there(run: Path, tmp_path: Path) -> None:
    stages, out = [Learning("one")], tmp_path / "trained"
    with pytest.raises(FileNotFoundError, match="no trained agents"):
        ship_more([], out)
    run_suite(stages, run, run, line=str)
    ship(stages, run, run, out)
    before = {path: path.read_bytes() for path in (out / "mine").iterdir()}
    other = save_driver(run / "two", 5) / "driver.json"
    ship_more([Agent("other", other, "drives too")], out)
    assert list(shipped_agents(out)) == ["mine", "other"]
    assert {path: path.read_bytes() for path in (out / "mine").iterdir()} == before
    load_policy(find_shipped("trained:other", "driver", out), "driver", TeamConfig())
    ship_more([Agent("mine", other, "drives in its place")], out)
    assert shipped_agents(out)["mine"].what == "drives in its place"
    weights = (out / "mine" / "driver.safetensors").read_bytes()
    assert weights == other.with_suffix(".safetensors").read_bytes()
    ship(stages, run, run, out)
    assert shipped_agents(out)["mine"].what == "drives"
    assert shipped_agents(out)["other"].what == "drives too", "of a run of its own: it stays"


def test_agents_that_infer_drivers_are_shipped_with_their_encoder_alone(tmp_path: Path) -> None:
    team, out = TeamConfig(ai_sees_attention=False), tmp_path / "trained"
    learned = save_trained(tmp_path / "run", team)
    cards = {"evidence": "evidence", "conditioned": "vehicle_ai"}
    inferring = [
        Agent(name, Path(getattr(learned, name)) / f"{card}.json", "infers")
        for name, card in cards.items()
    ]
    own, other = trait_model(), untrained(observed_layout(team))
    for name, model in (("own", own), ("other", other)):
        save_traits(tmp_path / name, model.card, model.weights)
    read, another = (
        Agent("traits-self", tmp_path / name / "traits.json", "encodes")
        for name in ("own", "other")
    )
    write_json(out / INDEX, with_checksum({"format": INDEX_FORMAT, "version": "1", "agents": {}}))
    ship_more([another], out)
    before = {path: path.read_bytes() for path in out.rglob("*.*")}
    with pytest.raises(ValueError, match=r"do not belong together: .* ship the stages traits"):
        ship_more(inferring, out)
    assert {path: path.read_bytes() for path in out.rglob("*.*")} == before
    ship_more([*inferring, read], out)
    assert set(shipped_agents(out)) == {"evidence", "conditioned", "traits-self"}
