import hashlib
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch

from hmi_marl.agents import make_driver_policy, make_hmi
from hmi_marl.agents.catalogue import known_names
from hmi_marl.agents.learned.cards import (
    FOLDER,
    INDEX,
    INDEX_FORMAT,
    find_shipped,
    is_shipped,
    shipped_agents,
    shipped_names,
)
from hmi_marl.agents.learned.trait_model import load_traits
from hmi_marl.agents.partners import make_vec
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs.config import TeamConfig, as_fatigue
from hmi_marl.files import with_checksum

AGENTS = shipped_agents()
ENCODERS = [name for name, agent in AGENTS.items() if agent.kind == "traits"]


def card_of(name: str) -> dict:
    return json.loads((FOLDER / AGENTS[name].card).read_text("utf-8"))


SEATED = [
    name
    for name, agent in AGENTS.items()
    if agent.kind in ("driver", "vehicle_ai") and not card_of(name)["context"]
]
"""Those that take a seat by themselves; one with a context needs z."""


def team_of(name: str) -> TeamConfig:
    """As the agent was trained for."""
    settings = card_of(name)["training"]["settings"]
    fatigue = settings.get("fatigue")
    return TeamConfig(
        driver="homer",
        ai_sees_attention=settings["ai_sees_attention"],
        alert_strengths=tuple(settings.get("alert_strengths", (1.0,))),
        fatigue=as_fatigue(fatigue),
        duration=1.0,
    )


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """Two of the agents, which may be altered."""
    for name in ("driver", "homer"):
        shutil.copytree(FOLDER / name, tmp_path / name)
    shutil.copy(FOLDER / INDEX, tmp_path / INDEX)
    return tmp_path


def test_all_that_is_shipped_is_indexed_and_small() -> None:
    files = {path.relative_to(FOLDER).as_posix() for path in FOLDER.rglob("*") if path.is_file()}
    indexed = {path for agent in AGENTS.values() for path in agent.files}
    assert files == indexed | {INDEX}
    assert sum((FOLDER / path).stat().st_size for path in files) < 20e6
    for agent in AGENTS.values():
        for path, digest in agent.files.items():
            assert hashlib.sha256((FOLDER / path).read_bytes()).hexdigest() == digest


def test_the_papers_agents_are_there() -> None:
    drivers = ["lisa", "marge", "bart", "homer", "average"]
    assert {"driver", "attentive-driver"} <= set(shipped_names("driver"))
    assert {*drivers, *(f"hidden-{name}" for name in drivers)} <= set(shipped_names("vehicle_ai"))
    assert set(ENCODERS) == {"traits-none", "traits-id", "traits-preference", "traits-self"}


@pytest.mark.parametrize("name", AGENTS)
def test_cards_say_how_they_were_made_and_name_no_places(name: str) -> None:
    card = card_of(name)
    training = card["training"]
    commands = "hmi-marl reproduce", "hmi-marl compare", "hmi-marl traits train"
    assert training["command"].startswith(commands)
    assert training["settings"]["seed"] == 0
    assert training["version"]
    assert not re.search(r'["\s=][/~]\w|[A-Za-z]:\\\\', json.dumps(card))
    policy = training["settings"].get("driver_policy")
    if policy not in (None, "rule"):
        assert policy["sha256"] == AGENTS["driver"].files["driver/driver.safetensors"]


@pytest.mark.parametrize("name", SEATED)
def test_each_policy_sits_down_and_acts(name: str) -> None:
    team, seat = team_of(name), AGENTS[name].kind
    make = make_driver_policy if seat == "driver" else make_hmi
    policy = make(f"trained:{name}", team)
    env = make_vec(6, "team", threads=1, **vars(team))
    policy.reset(np.arange(6, dtype=np.uint64))
    actions = policy.act(env.get_observations()[seat].numpy())
    assert actions.shape == (6,)
    most = 5 if seat == "driver" else 1 + len(team.alert_strengths)
    assert ((actions >= 0) & (actions < most)).all()


@pytest.mark.parametrize("name", ENCODERS)
def test_each_encoder_encodes(name: str) -> None:
    pytest.importorskip("pyarrow")
    model = load_traits(f"trained:{name}")
    settings = CollectSettings(drivers=("lisa", "homer"), steps=200)
    (windows,) = collect(settings)
    seen = windows.observed
    sums = model.encoder.encode(seen.states, seen.actions, seen.alerts, seen.length)
    latent = model.encoder.latent(sums)
    assert latent.mean.shape == (4, 8 if name == "traits-self" else 2)
    assert np.isfinite(latent.mean).all()


def test_names_are_listed_and_case_does_not_matter() -> None:
    assert "homer" in known_names("vehicle_ai")["trained:NAME"]
    assert "attentive-driver" in known_names("driver")["trained:NAME"]
    assert is_shipped("Trained:Homer")
    assert find_shipped("Trained:Homer", "vehicle_ai") == FOLDER / "homer" / "vehicle_ai.json"
    assert not is_shipped("runs/trained")


@pytest.mark.parametrize("make", [make_hmi, make_driver_policy])
def test_an_unknown_name_names_what_there_is(make) -> None:
    known = "trained:homer" if make is make_hmi else "trained:driver"
    with pytest.raises(ValueError, match=f"unknown trained agent 'trained:nobody'.*{known}"):
        make("trained:nobody", TeamConfig(driver="homer"))


def test_an_agent_of_another_kind_is_refused() -> None:
    with pytest.raises(ValueError, match=r"trained:driver is of kind driver .*not vehicle_ai"):
        make_hmi("trained:driver", TeamConfig(driver="homer"))
    with pytest.raises(ValueError, match=r"trained:homer is of kind vehicle_ai .*trained:traits-"):
        load_traits("trained:homer")


@pytest.mark.parametrize("suffix", ["json", "safetensors"])
def test_an_altered_or_missing_file_is_refused(suffix: str, copied: Path) -> None:
    path = copied / "homer" / f"vehicle_ai.{suffix}"
    assert find_shipped("trained:homer", "vehicle_ai", copied) == path.with_suffix(".json")
    content = bytearray(path.read_bytes())
    content[-2] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"is not the file that came .*install hmi-marl again"):
        find_shipped("trained:homer", "vehicle_ai", copied)
    find_shipped("trained:driver", "driver", copied)  # which is as it was
    path.unlink()
    with pytest.raises(FileNotFoundError, match=r"is missing; install hmi-marl again"):
        find_shipped("trained:homer", "vehicle_ai", copied)


def test_another_policy_in_its_place_is_refused(copied: Path) -> None:
    for suffix in ("json", "safetensors"):  # a pair that fits together
        shutil.copy(FOLDER / "bart" / f"vehicle_ai.{suffix}", copied / "homer")
    with pytest.raises(ValueError, match="is not the file that came with the package"):
        find_shipped("trained:homer", "vehicle_ai", copied)


def test_a_foreign_agent_is_refused(copied: Path) -> None:
    shutil.copytree(copied / "homer", copied / "stranger")
    with pytest.raises(ValueError, match="unknown trained agent 'trained:stranger'"):
        find_shipped("trained:stranger", "vehicle_ai", copied)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "is damaged"),
        ("[]", "is no index of trained agents"),
        ('{"format": "hmi-marl trained 1"}', "is no index of trained agents"),
        (
            '{"format": "hmi-marl trained 2"}',
            r"is damaged \(it has no checksum\); install hmi-marl",
        ),
        (
            json.dumps(with_checksum({"format": INDEX_FORMAT, "agents": {"homer": {}}})),
            r"is damaged \(agents\.homer lacks",
        ),
    ],
)
def test_an_index_that_is_none_is_refused(content: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no trained agents came with this package"):
        shipped_agents(tmp_path)
    (tmp_path / INDEX).write_text(content)
    with pytest.raises(ValueError, match=message):
        shipped_agents(tmp_path)


@pytest.mark.parametrize("kind", ["expected", "choosing", "conditioned"])
def test_adaptive_hmis_work_at_once_and_never_look_at_traits(kind: str) -> None:
    played = []
    for shown in (True, False):
        team = {"driver": "bart", "ai_sees_attention": False, "observe_traits": shown}
        hmi = make_hmi(f"adapt:{kind}", TeamConfig(**team))
        teams = make_vec(4, "vehicle_ai", "rule", seed=3, **team)
        hmi.reset(np.arange(4, dtype=np.uint64))
        alerts = []
        for _ in range(10):
            seen = teams.get_observations()["vehicle_ai"].numpy()
            alerts.append(hmi.act(seen))
            teams.step(torch.from_numpy(alerts[-1])[:, None])
        played.append(np.array(alerts))
    assert (played[0] == played[1]).all()
