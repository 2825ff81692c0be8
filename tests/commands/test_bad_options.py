"""A bad value of any option of any command: one line, status 2, and nothing is left behind."""

import re
import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from hmi_marl import workers
from hmi_marl.cli import main
from hmi_marl.training.runs import start

LONGEST = 20.0
"""Seconds on a busy machine. Most take a tenth; a training would take hours."""

TEAM = {
    "alert-window": ["0"],
    "alert-strengths": ["2", "nan"],
    "fatigue": ["0 0 2"],
    "duration": ["nan", "-1", "0.3"],
    "vehicles": ["-1 5", "3 1"],
}
PPO = {
    "num-learning-epochs": ["0"],
    "num-mini-batches": ["0", "100000"],
    "gamma": ["1.5", "nan"],
    "gae-lambda": ["-1", "nan"],
    "learning-rate": ["0", "nan", "inf"],
    "final-learning-rate": ["0", "nan"],
    "entropy-coef": ["-1", "nan"],
    "final-entropy-coef": ["-1", "nan"],
    "clip-param": ["0", "nan"],
    "max-grad-norm": ["0", "nan"],
    "reward-scale": ["0", "nan"],
}
NETWORK = {"hidden-dims": ["0"], "activation": ["nope"], "rnn-hidden-dim": ["-1"]}


def within(group: str, options: dict[str, list[str]]) -> dict[str, list[str]]:
    return {f"{group}.{name}": values for name, values in options.items()}


MACHINE = {"workers": ["0", "many"]}
RAY = {"ray": ["nope", "ray://nope", "127.0.0.1:9"]}
OUT = {"out": ["file", "file/below"]}
SIZES = {"num-teams": ["0"], "seed": ["-1"], "episodes": ["0"]}
TRAIN = {
    **TEAM,
    **OUT,
    "drivers": ["nobody", "homer:2,0,0,0"],
    "seed": ["-1"],
    "num-teams": ["0", "3"],
    "shards": ["3"],
    "condition": ["nope"],
    "critic": ["nope"],
    "rnn-hidden-dim": ["-1"],
    "hmi-reads": ["wheel"],
    **within("network", NETWORK),
    **within("ppo", PPO),
    "device": ["nope", "cuda:-1", "cuda:99", "mps"],
    "threads": ["0", "1000"],
    "snapshots": ["-1"],
    "checkpoint-every": ["nan", "-1", "inf"],
    "processes": ["0", "3", "1000"],
}
BAD: dict[str, dict[str, list[str]]] = {
    "adapt": {
        **MACHINE,
        **OUT,
        "driver-policy": ["nope", "/no/such", "trained:nobody"],
        "drivers": ["1"],
        "population": ["1"],
        "repeats": ["0"],
        "candidates": ["0"],
        "changes": ["1"],
        "revealing": ["nan", "2"],
        "caution": ["nan", "-1"],
        "seed": ["-1"],
        "evidence": ["/no/such", "trained:homer"],
        "conditioned": ["/no/such"],
        "hidden": ["/no/such", "/no/{}"],
    },
    "bench": {
        **OUT,
        "teams": ["0"],
        "threads": ["0"],
        "vehicles": ["0"],
        "scaling": ["0"],
        "vector-teams": ["0"],
        "seconds": ["0", "nan", "inf"],
        "rounds": ["0"],
    },
    "collect": {
        **TEAM,
        **OUT,
        "drivers": ["nobody", "homer homer"],
        "steps": ["0"],
        "population": ["-1"],
        "windows": ["0"],
        "alert-rate": ["2", "nan"],
        "driver-policy": ["nope", "/no/such"],
        "seed": ["-1"],
        "num-teams": ["0"],
    },
    "compare": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "protocols": ["nope"],
        "steps": ["0"],
        "driver-share": ["nan", "2"],
        "rounds": ["0"],
        "seeds": ["0"],
        "drivers": ["nobody"],
        "reward": ["nope"],
        "duration": ["nan", "-1"],
        "vehicles": ["-1 5"],
    },
    "export": {"policy": ["/no/such", "trained:nobody"], "seat": ["nope"]},
    "oracle": {
        **OUT,
        "driver": ["nobody"],
        "window": ["0"],
        "horizon": ["0"],
        "alert-strengths": ["2", "nan"],
        "fatigue": ["0 0 2"],
    },
    "reproduce all": {**MACHINE, **RAY, **OUT, "seed": ["-1"]},
    "reproduce table": {**MACHINE, **OUT, **SIZES, "driver-steps": ["0"], "hmi-steps": ["0"]},
    "reproduce driver": {**MACHINE, **RAY, **OUT, **SIZES, "steps": ["0"], "snapshots": ["-1"]},
    "reproduce hidden": {
        **MACHINE,
        **OUT,
        **SIZES,
        "driver-run": ["/no/such", "nope"],
        "driver-steps": ["0"],
        "hmi-steps": ["0"],
        "rnn-hidden-dim": ["0"],
    },
    "reproduce adapt": {
        **MACHINE,
        **OUT,
        "driver-run": ["/no/such"],
        "drives": ["0"],
        "updates": ["0"],
        "hmi-steps": ["0"],
        "rnn-hidden-dim": ["0"],
        "num-teams": ["0"],
        "seed": ["-1"],
        "hidden": ["/no/such"],
        "evaluation.drivers": ["1"],
        "evaluation.revealing": ["nan"],
    },
    "reproduce traits": {
        **MACHINE,
        **OUT,
        "driver-run": ["/no/such"],
        "driver-steps": ["0"],
        "demonstrated": ["0"],
        "population": ["2"],
        "seed": ["-1"],
        "seeds": ["0"],
        "learn.margin": ["0"],
        "learn.device": ["nope"],
        "evaluation.windows": ["0"],
    },
    "reproduce graded": {**MACHINE, **OUT, **SIZES, "hmi-steps": ["0"]},
    "reproduce protocols": {**MACHINE, **OUT, **SIZES, "protocols": ["nope"], "steps": ["0"]},
    "reproduce sweep": {
        **MACHINE,
        **OUT,
        "protocols": ["nope", "joint joint"],
        "over": ["steps", "steps=0"],
        "seeds": ["0"],
        "seed": ["-1"],
        "episodes": ["0"],
        "drivers": ["nobody", "homer homer"],
    },
    "reproduce ship --out out": {"run": ["/no/such", "nope"]},
    "sweep joint two-stage": {
        **MACHINE,
        **RAY,
        **OUT,
        "over": [
            "steps",
            "steps=",
            "steps=many",
            "steps=0",
            "steps=1.5",
            "step=10",
            "steps=10,10",
            "steps=10 steps=20",
            "steps=1..2/1",
            "steps=0..2/3/log",
            "seed=1",
            "threads=1",
            "hmi_for=homer",
            "two-stage:hmi_for=nobody",
            "two-stage:driver_policy=/no/such",
            "alternating:rounds=2",
            "critic=nope",
            "end_at_crash=maybe",
            "vehicles=1",
            "vehicles=3+1",
            "drivers=homer+nobody",
            "duration=nan",
            "ppo.learning_rate=1e-3,20",
            "ppo.num_mini_batches=100000",
            "network.activation=nope",
            "device=cuda:99",
            "seed_=1",
        ],
        "seeds": ["0", "100000"],
        "seed": ["-1"],
        "episodes": ["0"],
        "drivers": ["nobody", "homer homer"],
    },
    "sweep nope": {"": [""]},
    "table": {
        **MACHINE,
        **TEAM,
        **OUT,
        "drivers": ["nobody", "homer homer"],
        "hmis": ["siren", "/no/such"],
        "driver-policy": ["ace", "/no/such"],
        "episodes": ["0"],
        "seed": ["-1"],
        "world": ["moon"],
    },
    "train two-stage": {
        **TRAIN,
        "hmi-for": ["nobody"],
        "driver-policy": ["nope", "/no/such"],
        "driver-steps": ["-1"],
        "hmi-steps": ["-1"],
        "hmi-reward": ["nope"],
    },
    "train alternating": {
        **OUT,
        "rounds": ["0"],
        "driver-steps": ["0"],
        "hmi-steps": ["0"],
        "driver-reward": ["nope"],
        "threads": ["1000"],
        "device": ["nope"],
        "checkpoint-every": ["nan"],
    },
    "train joint": {**OUT, "steps": ["0"], "device": ["nope"], "threads": ["1000"]},
    "train simultaneous": {**OUT, "steps": ["0"], "device": ["nope"], "threads": ["1000"]},
    "traits train": {
        "demonstrations": ["/no/such"],
        "preferences": ["/no/such"],
        "supervision": ["nope"],
        "labelled": ["0", "nan"],
        "held-out": ["1", "nan"],
        "margin": ["0"],
        "latent": ["0"],
        "pool": ["0", "7"],
        "steps": ["0"],
        "expert-pools": ["3"],
        "learning-rate": ["0", "nan"],
        "imitation-rate": ["nan"],
        "device": ["nope"],
        "threads": ["0", "1000"],
        "checkpoint-every": ["nan"],
        "seed": ["-1"],
        **within("ppo", {"gamma": ["nan"]}),
    },
    "traits evaluate": {
        "": [""],
        "demonstrations": ["/no/such"],
    },
    "watch --out clip.gif": {
        **TEAM,
        "driver": ["nobody"],
        "hmi": ["siren", "/no/such"],
        "policy": ["ace", "/no/such"],
        "seed": ["-1"],
        "out": ["clip.txt", "file/clip.gif"],
    },
}


@dataclass(frozen=True)
class Case:
    command: str
    option: str
    value: str

    @property
    def arguments(self) -> list[str]:
        option = f"--{self.option}" if self.option else ""
        return f"{self.command} {option} {self.value}".split()


CASES = [
    Case(command, option, value)
    for command, options in BAD.items()
    for option, values in options.items()
    for value in values
]


@pytest.fixture
def in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """With a file in the way of ``--out file``, and no worker process."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    monkeypatch.delenv("WORLD_SIZE", raising=False)

    def started(*_: object, **__: object) -> None:
        raise AssertionError("a process was started before everything was checked")

    monkeypatch.setattr(start, "SharedMemory", started)
    monkeypatch.setattr(workers, "ProcessPoolExecutor", started)
    return tmp_path


@pytest.mark.parametrize("command", BAD)
def test_bad_values_leave_one_line_and_nothing_else(
    command: str, in_an_empty_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for package in ("torch", "rsl_rl", "pyarrow", "sklearn", "onnx", "ray"):
        pytest.importorskip(package)
    wrong = []
    for case in CASES:
        if case.command != command:
            continue
        began = time.monotonic()
        try:
            status: object = main(case.arguments)
        except SystemExit as stop:
            status = stop.code
        except BaseException as error:  # a traceback for the user
            status = repr(error)
        took, printed = time.monotonic() - began, capsys.readouterr()
        left = sorted(str(path) for path in in_an_empty_folder.rglob("*") if path.name != "file")
        if (
            status != 2
            or left
            or printed.out
            or not re.fullmatch(r"hmi-marl: [^\n]+\n", printed.err)
            or took > LONGEST
        ):
            wrong.append((" ".join(case.arguments), status, left[:3], printed.err[-300:], took))
    assert not wrong, "\n".join(map(str, wrong))
