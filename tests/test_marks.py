"""What using this package leaves behind in a process: nothing. Each program runs in its own."""

from pathlib import Path

import pytest
from fresh import run

MARKS = """
import locale, logging, os, random, signal, sys, warnings
import gymnasium, highway_env, matplotlib, numba, numpy as np, pettingzoo, pygame, torch
import rsl_rl.env, scipy.stats, tensordict  # what others mark as they are imported is theirs


def marks():
    return {
        "random": random.getstate(),
        "numpy.random": repr(np.random.get_state()),
        "torch random": torch.get_rng_state().tolist(),
        "warnings": list(warnings.filters),
        "environ": dict(os.environ),
        "locale": locale.setlocale(locale.LC_ALL),
        "logging": (logging.root.level, logging.root.manager.disable, list(logging.root.handlers)),
        "matplotlib": dict.copy(matplotlib.rcParams),
        "pyplot": "matplotlib.pyplot" in sys.modules,
        "numpy": (np.geterr(), np.get_printoptions()),
        "torch": (
            torch.get_default_dtype(),
            torch.is_grad_enabled(),
            torch.are_deterministic_algorithms_enabled(),
        ),
        "folder": os.getcwd(),
        "signals": {one: signal.getsignal(one) for one in signal.valid_signals()},
        "interpreter": (sys.getrecursionlimit(), sys.excepthook, list(sys.path)),
        "display": (pygame.display.get_init(), pygame.display.get_caption()),
    }


def check(what):
    global before
    after = marks()
    for name, mark in after.items():
        assert mark == before[name], f"{what}: {name} was {before[name]!r}, now {mark!r}"
"""
OTHER_PICTURE = """
import hashlib
import gymnasium, highway_env


def other_picture():
    env = gymnasium.make("merge-v0", render_mode="rgb_array")
    env.reset(seed=1)
    env.step(1)
    picture = env.render().tobytes()
    env.close()
    assert len(set(picture)) > 4, "black"
    return picture
"""
ENVIRONMENTS = """
random.seed(1), np.random.seed(2), torch.manual_seed(3)
before = marks()
import hmi_marl
from hmi_marl import merge_v0
check("import")
SETTINGS = dict(driver=["bart", "homer"], world=WORLD, duration=1.0)


def uses(mode):
    for make in (merge_v0.env, merge_v0.raw_env, merge_v0.parallel_env):
        env = make(render_mode=mode, **SETTINGS)
        check("make")
        env.reset(seed=0), env.reset()
        check("reset")
        for _ in range(2):
            if make is merge_v0.parallel_env:
                env.step({"driver": 3, "vehicle_ai": 1})
            else:
                env.step(3), env.step(1)
        check("step")
        env.render(), env.close()
        check(f"render {make.__name__}")
    for seat, partner in (("Driver", "random:0.3"), ("HMI", "random")):
        name = f"hmi_marl/Merge{seat}-v0"
        env = gymnasium.make(name, partner=partner, render_mode=mode, **SETTINGS)
        env.reset(seed=0), env.step(1), env.render(), env.close()
        check(f"render {name}")


uses("rgb_array")
with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # that there is no display to open a window on
    filters, before["warnings"] = before["warnings"], list(warnings.filters)
    uses("human")
before["warnings"] = filters
for seat in ("driver", "vehicle_ai", "team"):
    teams = hmi_marl.make_vec(3, seat=seat, **SETTINGS)
    teams.reset(seed=1), teams.reset()
    for _ in range(6):  # past the end of an episode
        teams.step(torch.ones(3, teams.num_actions))
    teams.picture(1), teams.close()
    check(f"make_vec {seat}")
"""
PAGES = """
random.seed(1), np.random.seed(2), torch.manual_seed(3)
from pathlib import Path
import h5py, minari, safetensors.torch, sklearn.cluster, tqdm, tyro
import torch.utils.tensorboard
from hmi_marl.commands.collect import Collect
from hmi_marl.commands.table import TableCommand
from hmi_marl.demonstrations.recording import CollectSettings
from hmi_marl.experiments.metrics_table.table import TableConfig, TableSettings, make_table

FOLDER = Path(sys.argv[1])
before = marks()
few = TableSettings(drivers=("homer",), hmis=("NoHMI", "own"), episodes=2, duration=1.0)
TableCommand(few, workers=1, out=FOLDER / "table").run("")  # figures, a page and a clip
assert (FOLDER / "table" / "clip.gif").exists() and (FOLDER / "table" / "table.png").exists()
check("table")
TableCommand(few, workers=2, clip=False, out=FOLDER / "again").run("")
check("table of two processes")
demonstrations = CollectSettings(drivers=("homer", "lisa"), steps=20, duration=1.0)
Collect(demonstrations, minari=True, out=FOLDER / "data").run("")
check("collect")
"""
LEARNING = """
random.seed(1), np.random.seed(2), torch.manual_seed(3)
from pathlib import Path
import torch.utils.tensorboard, tqdm
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.training.ppo.run import train
from hmi_marl.training.protocols.settings import PPOSettings
from hmi_marl.training.protocols.two_stage import TwoStage

before = marks()
size = {"num_teams": 4, "duration": 1.0, "network": NetworkConfig((8,)), "threads": 1}
ppo = PPOSettings(num_learning_epochs=1, num_mini_batches=2)
settings = TwoStage(driver_steps=20, hmi_steps=20, ppo=ppo, device="cpu", **size)
train(settings, Path(sys.argv[1]) / "run", quiet=True)
check("train")
"""
HIGHWAY_FIRST = """
from hmi_marl import merge_v0

first = other_picture()
ours = merge_v0.parallel_env(render_mode="rgb_array", duration=1.0)
ours.reset(seed=0)
picture = ours.render().tobytes()
assert other_picture() == first, "after ours"
assert ours.render().tobytes() == picture, "after highway-env's, which quits pygame"
ours.close()
assert other_picture() == first, "after ours is closed"
print(hashlib.sha256(first).hexdigest())
"""
OURS_FIRST = """
from hmi_marl import merge_v0

ours = merge_v0.env(render_mode="rgb_array", duration=1.0)
ours.reset(seed=0)
ours.render()
between = other_picture()
ours.render()
ours.close()
assert other_picture() == between
print(hashlib.sha256(between).hexdigest())
"""
ALONE = "print(hashlib.sha256(other_picture()).hexdigest())"
NO_DISPLAY = {"DISPLAY": "", "WAYLAND_DISPLAY": "", "SDL_VIDEODRIVER": ""}

pytestmark = pytest.mark.usefixtures("unmeasured")


def test_environments_and_learning_leave_no_mark(tmp_path: Path) -> None:
    worlds = [f"WORLD = {world!r}\n{ENVIRONMENTS}" for world in ("highway", "batched")]
    run("-c", "".join([MARKS, *worlds, LEARNING]), tmp_path, **NO_DISPLAY)


@pytest.mark.slow
def test_tables_figures_clips_and_datasets_leave_no_mark(tmp_path: Path) -> None:
    run("-c", MARKS + PAGES, tmp_path, **NO_DISPLAY, MINARI_DATASETS_PATH="")


@pytest.mark.slow
def test_highway_envs_own_pictures_are_the_same_before_between_and_after_ours() -> None:
    pictures = {
        run("-c", OTHER_PICTURE + program, **NO_DISPLAY).split()[-1]
        for program in (ALONE, HIGHWAY_FIRST, OURS_FIRST)
    }
    assert len(pictures) == 1
