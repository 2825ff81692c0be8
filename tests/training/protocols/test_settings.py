import subprocess
import sys

import pytest

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.files import json_value
from hmi_marl.training.protocols.alternating import Alternating
from hmi_marl.training.protocols.fine_tune import FineTune
from hmi_marl.training.protocols.joint import Joint, Simultaneous
from hmi_marl.training.protocols.settings import PPOSettings, TrainSettings
from hmi_marl.training.protocols.two_stage import TwoStage

PROTOCOLS = (TwoStage, Joint, Simultaneous, Alternating, FineTune)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"num_learning_epochs": 0}, "num_learning_epochs lies in 1 to .*, but got 0"),
        ({"num_mini_batches": 0}, "num_mini_batches lies in 1 to .*, but got 0"),
        ({"gamma": 1.01}, r"gamma lies in \[0, 1\], but got 1\.01"),
        ({"gae_lambda": -0.1}, r"gae_lambda lies in \[0, 1\]"),
        ({"gamma": float("nan")}, "gamma lies in"),
        ({"learning_rate": 0.0}, r"learning_rate lies in .*, but got 0\.0"),
        ({"final_learning_rate": float("inf")}, "final_learning_rate lies in"),
        ({"clip_param": float("nan")}, "clip_param lies in"),
        ({"max_grad_norm": -1.0}, "max_grad_norm lies in"),
        ({"reward_scale": 0.0}, "reward_scale lies in"),
        ({"entropy_coef": -0.01}, r"entropy_coef lies in .*, but got -0\.01"),
        ({"final_entropy_coef": float("nan")}, "final_entropy_coef lies in"),
    ],
    ids=str,
)
def test_what_ppo_cannot_be_told(changed, told):
    with pytest.raises(ValueError, match=told):
        PPOSettings(**changed)


def test_what_ppo_may_be_told_at_the_edges():
    PPOSettings(1, 1, 0.0, 1.0, entropy_coef=0.0, final_entropy_coef=0.0)


@pytest.mark.parametrize("protocol", PROTOCOLS)
@pytest.mark.parametrize(
    ("changed", "error", "told"),
    [
        ({"seed": -1}, ValueError, r"a seed lies in \[0, 2\^64\), but got -1"),
        ({"seed": 0.5}, TypeError, "a seed is an integer, not 0.5"),
        ({"num_teams": 0}, ValueError, "num_teams lies in 1 to .*, but got 0"),
        ({"snapshots": -1}, ValueError, "snapshots lies in 0 to .*, but got -1"),
        (
            {"checkpoint_every": -1.0},
            ValueError,
            "checkpoint_every lies in .*, but got -1.0",
        ),
        ({"threads": 0}, ValueError, "threads lies in 1 to .*, but got 0"),
        ({"shards": 0}, ValueError, "shards lies in 1 to .*, but got 0"),
        ({"shards": 6}, ValueError, "shards is a power of two such as 2, 4 or 8, but got 6"),
        (
            {"network": NetworkConfig(rnn_hidden_dim=3)},
            ValueError,
            "set rnn_hidden_dim, not network.rnn_hidden_dim",
        ),
        ({"rnn_hidden_dim": -1}, ValueError, "rnn_hidden_dim lies in 0 to .*, but got -1"),
        (
            {"num_teams": 4, "ppo": PPOSettings(num_mini_batches=5)},
            ValueError,
            "cannot split 4 teams into 5 mini-batches; lower --ppo.num-mini-batches",
        ),
        ({"hmi_reads": ("weather",)}, ValueError, "no part 'weather' to read; there are lidar"),
        ({"drivers": ("ned",)}, ValueError, "unknown driver 'ned'"),
        ({"drivers": ()}, ValueError, "at least one"),
        ({"duration": 0.3}, ValueError, "not a whole number of steps"),
        ({"vehicles": (5, 2)}, ValueError, "vehicles"),
        ({"alert_window": 0}, ValueError, "window"),
    ],
    ids=str,
)
def test_what_no_protocol_can_be_told(protocol, changed, error, told):
    with pytest.raises(error, match=told):
        protocol(**changed)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: TwoStage(driver_steps=0), "driver_steps lies in 1 to .*, but got 0"),
        (lambda: TwoStage(hmi_steps=-1), "hmi_steps lies in 0 to .*, but got -1"),
        (lambda: TwoStage(hmi_steps=0, driver_policy="rule"), "hmi_steps lies in 1 to"),
        (lambda: TwoStage(hmi_for="ned"), "unknown driver 'ned'"),
        (lambda: Joint(steps=0), "steps lies in 1 to"),
        (lambda: Joint(sequential=False), "composite policy draws a\\^A given a\\^H"),
        (lambda: Simultaneous(anchor_kl=0.5), "anchor_kl = 0.5 needs an anchor, such as --anchor"),
        (lambda: Joint(anchor="x", anchor_kl=-1.0), r"anchor_kl lies in \[0, "),
        (lambda: FineTune(together_steps=0), "together_steps lies in 1 to"),
        (lambda: FineTune(together_progress=1.5), r"together_progress lies in \[0, 1\]"),
        (lambda: Simultaneous(steps=-5), "steps lies in 1 to .*, but got -5"),
        (lambda: Alternating(rounds=0), "rounds lies in 1 to"),
        (lambda: Alternating(driver_steps=0), "driver_steps lies in 1 to"),
        (lambda: Alternating(hmi_steps=0), "hmi_steps lies in 1 to"),
    ],
)
def test_what_a_protocol_cannot_be_told(make, told):
    with pytest.raises(ValueError, match=told):
        make()


@pytest.mark.parametrize(
    ("num_teams", "num_mini_batches", "shards", "used"),
    [
        (512, 16, 4, 4),
        (512, 16, 64, 32),  # 16 teams each, one for each mini-batch
        (30, 2, 4, 2),  # 30 is no multiple of 4
        (16, 16, 4, 1),
        (16, 3, 4, 4),
        (7, 2, 4, 1),
    ],
)
def test_shards_are_halved_while_the_teams_do_not_suffice(
    num_teams, num_mini_batches, shards, used
):
    ppo = PPOSettings(num_mini_batches=num_mini_batches)
    assert TwoStage(num_teams=num_teams, shards=shards, ppo=ppo).shards_used == used


def test_settings_alone_lay_out_no_phases():
    with pytest.raises(NotImplementedError, match="a protocol lays out its phases"):
        TrainSettings().phases()


@pytest.mark.parametrize("protocol", PROTOCOLS)
def test_settings_are_fit_for_json_and_know_their_defaults(protocol):
    told = json_value(protocol())
    assert told["drivers"] == ["lisa", "marge", "bart", "homer"]
    assert told["ppo"]["gamma"] == 0.98
    assert told["network"] == {"hidden_dims": [64, 64], "activation": "relu", "rnn_hidden_dim": 0}
    assert told["duration"] == 20.0


def test_a_driver_of_ones_own_may_drive():
    settings = TwoStage(drivers=("maggie:0.5,0.1,0.2,2.0",), hmi_for="maggie:0.5,0.1,0.2,2.0")
    for phase in settings.phases():
        assert phase.team.only_driver.beta == 0.5


def test_telling_what_to_train_imports_no_torch():
    code = (
        "import sys\n"
        "from hmi_marl.training.protocols.registry import PROTOCOLS\n"
        "[entry.value().phases() for entry in PROTOCOLS.values()]\n"
        "print(sorted(m for m in sys.modules if m.split('.')[0] in ('torch', 'rsl_rl')))"
    )
    command = [sys.executable, "-c", code]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert printed.strip() == "[]"
