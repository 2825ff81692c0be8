"""HMIs and driver policies of a user work by name everywhere after one line of registration."""

import json
import re

import gymnasium
import numpy as np
import pytest

from hmi_marl import make_driver_policy, make_hmi
from hmi_marl.agents.catalogue import DRIVER_POLICIES, HMIS
from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig

CONFIG = TeamConfig(driver="homer", duration=1.0)
SMALL = ["--duration", "1", "--vehicles", "1", "1"]


class EveryFewSteps:
    """Act in every n-th step, otherwise do ``idle``."""

    def __init__(self, config, action=1, idle=0, n=3):
        self.horizon, self.action, self.idle, self.n = config.horizon, action, idle, n

    def reset(self, seeds, which=None):
        self.step = np.where(which, 0, self.step) if which is not None else np.zeros(len(seeds))

    def act(self, observations):
        self.step += 1
        return np.where(self.step % self.n == 0, self.action, self.idle)


def with_argument(config, argument, sequential):
    hmi = EveryFewSteps(config, n=int(argument or 4))
    hmi.seen = sequential
    return hmi


def braking(config, argument):
    return EveryFewSteps(config, 4, 1, int(argument))


@pytest.fixture
def registered():
    HMIS.register("every-third", "alerts in every third step", EveryFewSteps)
    HMIS.register("every-few", "alerts every N steps", with_argument, ("few",), "[:N]")
    HMIS.register("every-fifth", "alerts in every fifth step", "every-few:5")
    DRIVER_POLICIES.register("braker", "brakes at times", lambda c: EveryFewSteps(c, 4, 1))
    DRIVER_POLICIES.register(
        "brakes", "brakes every N", lambda c, n: EveryFewSteps(c, 4, 1, int(n)), argument=":N"
    )
    yield
    for name in ("every-third", "every-few", "every-fifth"):
        HMIS.unregister(name)
    for name in ("braker", "brakes"):
        DRIVER_POLICIES.unregister(name)


@pytest.mark.usefixtures("registered")
def test_they_are_made_by_name():
    assert isinstance(make_hmi("Every-Third", CONFIG), EveryFewSteps)
    assert isinstance(make_driver_policy("braker", CONFIG), EveryFewSteps)
    assert make_driver_policy("brakes:7", CONFIG).n == 7
    for name, n in (("every-few", 4), ("few:2", 2), ("every-fifth", 5)):
        for sequential in (True, False):
            hmi = make_hmi(name, CONFIG, sequential)
            assert (hmi.n, hmi.seen) == (n, sequential)


@pytest.mark.usefixtures("registered")
def test_errors_know_them():
    with pytest.raises(ValueError, match=r"unknown HMI 'every-thrid'; did you mean every-third"):
        make_hmi("every-thrid", CONFIG)
    with pytest.raises(ValueError, match="HMI 'every-third' takes no argument"):
        make_hmi("every-third:2", CONFIG)
    with pytest.raises(ValueError, match=r"did you mean braker"):
        make_driver_policy("brakr", CONFIG)


@pytest.mark.usefixtures("registered")
def test_help_lists_them(capsys):
    with pytest.raises(SystemExit):
        main(["--help"])
    printed = capsys.readouterr().out
    for name, meaning in (
        ("every-third", "alerts in every third step"),
        (r"every-few\[:N\]", "alerts every N steps"),
        ("braker", "brakes at times"),
    ):
        assert re.search(rf"(?m)^ +{name} +{meaning}$", printed)


@pytest.mark.usefixtures("registered")
def test_commands_take_them(tmp_path, capsys):
    arguments = ["table", "--drivers", "homer", "--hmis", "never", "every-third", "few:2"]
    arguments += ["--driver-policy", "braker", "--episodes", "1", "--workers", "1", "--no-clip"]
    assert main([*arguments, *SMALL, "--out", str(tmp_path)]) == 0
    cells = json.loads((tmp_path / "table.json").read_text())["cells"]
    assert [(cell["hmi"], cell["alerts"]) for cell in cells] == [
        ("never", 0.0),
        ("every-third", 60.0),
        ("few:2", 120.0),
    ]
    clip = tmp_path / "clip.gif"
    watch = ["watch", "--hmi", "every-third", "--policy", "braker", *SMALL, "--out", str(clip)]
    assert main(watch) == 0
    assert clip.stat().st_size > 0


@pytest.mark.usefixtures("registered")
def test_gymnasium_takes_them_as_partners():
    env = gymnasium.make("hmi_marl/MergeDriver-v0", partner="every-third", duration=1.0)
    env.reset(seed=0)
    assert [env.step(1)[-1]["accepted"] for _ in range(4)] == [False, False, True, True]
    env = gymnasium.make("hmi_marl/MergeHMI-v0", partner="braker", duration=1.0)
    layout = env.unwrapped.layout
    seen = [env.reset(seed=0)[0], *(env.step(0)[0] for _ in range(3))]
    assert [int(layout.chosen(one, "intended_action")) for one in seen] == [1, 1, 4, 1]


def test_they_are_gone_afterwards():
    for make, names in ((make_hmi, ("every-third", "few")), (make_driver_policy, ("braker",))):
        for name in names:
            with pytest.raises(ValueError, match="unknown"):
                make(name, CONFIG)
