"""Options as they are typed; wrong ones are in tests/commands/test_bad_options.py too."""

import pytest

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.experiments.sweep.options import (
    Swept,
    make_settings,
    options_of,
    read_swept,
    written,
)
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.registry import PROTOCOLS
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

ALL = tuple(PROTOCOLS)


def values(text: str, *protocols: str):
    return read_swept(text, protocols or ("simultaneous",)).values


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("steps=1e6,2_000_000", (1_000_000, 2_000_000)),
        ("ppo.learning_rate=1e-3,2e-3", (0.001, 0.002)),
        ("ppo.learning-rate=1e-4..1e-2/3/log", (1e-4, 1e-3, 1e-2)),
        ("ppo.gamma=0.9..0.99/4", (0.9, 0.93, 0.96, 0.99)),
        ("rnn_hidden_dim=8..64/4/log", (8, 16, 32, 64)),
        ("num_teams=128..512/4", (128, 256, 384, 512)),
        ("ai_sees_attention=true,false", (True, False)),
        ("critic=own,team", ("own", "team")),
        ("vehicles=1+5,1+20", ((1, 5), (1, 20))),
        ("network.hidden_dims=64+64,128", ((64, 64), (128,))),
        ("alert_strengths=1,0.5+1", ((1.0,), (0.5, 1.0))),
        ("fatigue=none,10+2+0.5", (None, (10, 2, 0.5))),
        (
            "drivers=homer+lisa,fast:0.1,0.5,0.01,1.5+bart",
            (("homer", "lisa"), ("fast:0.1,0.5,0.01,1.5", "bart")),
        ),
        ("hmi_reads=time", (("time",),)),
    ],
)
def test_lists_and_ranges_are_read_by_the_type_of_the_option(text, expected):
    found = values(text)
    assert found == expected
    assert [type(value) for value in found] == [type(value) for value in expected]


def test_a_text_keeps_commas_before_digits():
    found = values("hmi_for=homer,fast:0.1,0.5,0.01,1.5,lisa", "two-stage")
    assert found == ("homer", "fast:0.1,0.5,0.01,1.5", "lisa")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rnn_hidden_dim=8..64/4", r"rnn_hidden_dim is a whole number, not 26\.6"),
        ("steps=1e400", "steps is a finite number, not '1e400'"),
        ("steps=1,,2", "steps is a number, not ''"),
        ("vehicles=1+2+3", r"vehicles takes 2 parts, \.\.\.\+\.\.\., not '1\+2\+3'"),
        ("hmi_for=homer", "unknown option of simultaneous 'hmi_for'"),
        ("ppo=1", "unknown option of simultaneous 'ppo'"),
    ],
)
def test_what_does_not_fit_is_named(text, message):
    with pytest.raises(ValueError, match=message):
        values(text)


def test_an_option_of_one_protocol_is_named_with_it():
    assert read_swept("two-stage:hmi_for=homer", ALL) == Swept("hmi_for", ("homer",), "two-stage")
    with pytest.raises(ValueError, match="joint has no option hmi_for; two-stage:hmi_for=homer sw"):
        read_swept("hmi_for=homer", ALL)


def test_every_protocol_has_steps_in_all():
    assert all("steps" in options_of(PROTOCOLS[name].value) for name in ALL)
    with_share = {name for name in ALL if "driver_share" in options_of(PROTOCOLS[name].value)}
    assert with_share == {"two-stage", "alternating", "fine-tune"}
    assert not any({"seed", "threads"} & set(options_of(PROTOCOLS[name].value)) for name in ALL)


def test_settings_are_those_that_train_would_make():
    options = {"steps": 5, "ppo.gamma": 0.9, "ppo.clip_param": 0.3, "network.activation": "relu"}
    assert make_settings("joint", options, 3) == Joint(
        steps=5,
        ppo=PPOSettings(gamma=0.9, clip_param=0.3),
        network=NetworkConfig(activation="relu"),
        seed=3,
    )
    assert make_settings("simultaneous", {"sequential": False}, 0) == Simultaneous(sequential=False)


def test_steps_are_shared_out_among_stages_in_whole_batches():
    batch = 8 * 10
    common = {"num_teams": 8, "duration": 2.0, "ppo.num_mini_batches": 2}
    found = make_settings("two-stage", common | {"steps": 10 * batch, "driver_share": 0.3}, 0)
    assert isinstance(found, TwoStage)
    assert (found.driver_steps, found.hmi_steps) == (3 * batch, 7 * batch)
    found = make_settings("alternating", common | {"steps": 10 * batch, "rounds": 2}, 0)
    assert isinstance(found, Alternating)
    assert (found.rounds, found.driver_steps, found.hmi_steps) == (2, 8 * batch, 2 * batch)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"steps": 10, "hmi_steps": 5}, "steps and hmi_steps exclude each other"),
        ({"driver_share": 0.5}, "driver_share shares out steps"),
        ({"steps": 10, "driver_policy": "rule"}, "a driver_policy leaves no steps to share out"),
    ],
)
def test_options_that_exclude_each_other_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        make_settings("two-stage", options, 0)


def test_values_are_written_as_they_are_typed():
    assert [written(v) for v in (True, None, 0.1, 1_000_000, (64, 32), ("a", 0.5))] == [
        "true",
        "none",
        "0.1",
        "1000000",
        "64+32",
        "a+0.5",
    ]
