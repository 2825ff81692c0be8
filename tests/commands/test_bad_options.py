"""A bad value of any option of any command: one line, status 2, and nothing is left behind."""

import re
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from hmi_marl import workers
from hmi_marl.agents.learned.trait_model import save_traits
from hmi_marl.cli import main
from hmi_marl.commands.registry import SUBCOMMANDS
from hmi_marl.files import sha256_of, write_json
from hmi_marl.people.store import Store
from hmi_marl.people.study.ratings import write_answers
from hmi_marl.people.study.settings import Plan
from hmi_marl.people.study.simulated import simulated_answers
from hmi_marl.training.runs import start

LONGEST = 20.0
"""Seconds on a busy machine. Most take a tenth; a training would take hours."""

FLAG = ["nope"]
"""A flag takes no value."""
QUICK = ["nope", "--seed -1"]
TEAM = {
    "alert-window": ["0"],
    "alert-strengths": ["2", "nan"],
    "fatigue": ["0 0 2"],
    "duration": ["nan", "-1", "0.3"],
    "vehicles": ["-1 5", "3 1"],
    "end-at-crash": FLAG,
    "ai-sees-attention": FLAG,
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


LEARNER = {
    "device": ["nope", "cuda:-1", "cuda:99", "mps"],
    "threads": ["0", "1000"],
    "checkpoint-every": ["nan", "-1", "inf"],
}
SAMPLING = {
    "groups": ["1"],
    **{name: ["0"] for name in ("shared", "rounds", "most-rounds", "effective")},
}
WEIGHTS = ("reconstruct", "information", "contrast", "regularise", "cohesion", "imitate")
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
    "sequential": FLAG,
    "rnn-hidden-dim": ["-1"],
    "hmi-reads": ["wheel"],
    **within("network", NETWORK),
    **within("ppo", PPO),
    **LEARNER,
    "snapshots": ["-1"],
    "processes": ["0", "3", "1000"],
}
TRAITS = {
    **LEARNER,
    "supervision": ["nope"],
    "labelled": ["0", "nan"],
    "label-bandwidth": ["-1", "nan"],
    "margin": ["0", "inf"],
    "held-out": ["1", "nan"],
    "latent": ["0"],
    "pool": ["0", "7"],
    "average-updates": ["-1"],
    "encoder-updates": ["-1"],
    "drivers-per-update": ["1"],
    "encoder-rate": ["0", "nan"],
    "weight-decay": ["-1", "nan"],
    "steps": ["0"],
    "num-teams": ["0"],
    "expert-pools": ["3", "0"],
    "imitation-updates": ["-1"],
    "labelled-pools": ["0"],
    "updates": ["0"],
    "settling": ["2", "nan"],
    "learning-rate": ["0", "nan"],
    "imitation-rate": ["nan", "-1"],
    "information-reward": ["nan", "-1"],
    "seed": ["-1"],
    **within("weights", {name: ["-1", "nan"] for name in WEIGHTS}),
    **within("policy", NETWORK),
    **within("reward", NETWORK),
    **within("potential", NETWORK),
    **within(
        "encoder",
        {
            **{name: ["0"] for name in ("state-features", "step-features", "span", "features")},
            **within("head", NETWORK),
            **within("average", NETWORK),
        },
    ),
    **within("ppo", PPO),
}
ADAPT = {
    "drivers": ["1"],
    "population": ["1"],
    "repeats": ["0"],
    "candidates": ["0"],
    "changes": ["1"],
    "revealing": ["nan", "2"],
    "caution": ["nan", "-1"],
    "seed": ["-1"],
}
ASSESS = {
    "windows": ["0"],
    "episodes": ["0"],
    "ranked": ["0"],
    "posteriors": ["-1", "2"],
    "seed": ["-1"],
}
ANCHOR = {
    "anchor": ["nope", "rule", "/no/such", "trained:nobody", "trained:homer"],
    "anchor-kl": ["-1", "nan", "1"],  # the last lacks an anchor
}
COMPARE = {
    **MACHINE,
    **RAY,
    **OUT,
    **SIZES,
    "tasks": ["nope"],
    "protocols": ["nope"],
    "steps": ["0"],
    "budgets": ["0", "10 10"],
    "driver-shares": ["nan", "2", "0.5 0.5"],
    "rounds": ["0"],
    "seeds": ["0"],
    "few-seeds": ["0"],
    "anchor-kls": ["-1", "nan"],
    "partners": FLAG,
    "snapshots": ["0"],
    "cross-episodes": ["0", "1"],
    "drivers": ["nobody"],
    "reward": ["nope"],
    "crash-check": FLAG,
    "duration": ["nan", "-1"],
    "vehicles": ["-1 5"],
    "quick": [*QUICK, "--episodes 7"],
}
BAD: dict[str, dict[str, list[str]]] = {
    "adapt": {
        **MACHINE,
        **OUT,
        **ADAPT,
        "quick": [*QUICK, "--repeats 3"],
        "clip": FLAG,
        "driver-policy": ["nope", "/no/such", "trained:nobody"],
        "evidence": ["/no/such", "trained:homer"],
        "conditioned": ["/no/such"],
        "hidden": ["/no/such", "/no/{}"],
        "traits": ["/no/such", "trained:homer"],
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
        "hmi": ["nope", "optimal", "/no/such", "average --alert-rate 0.3"],
        "alert-rate": ["2", "nan"],
        **{trait: ["0 2", "0.5 0.4", "nan 1"] for trait in ("beta", "alpha", "eta")},
        "inflation": ["0 3", "5 4", "3 21"],
        "drift": ["2", "nan"],
        "driver-policy": ["nope", "/no/such"],
        "seed": ["-1"],
        "num-teams": ["0"],
        "minari": FLAG,
        "greedy": FLAG,
    },
    "compare": COMPARE,
    "export": {
        "policy": ["/no/such", "trained:nobody"],
        "seat": ["nope"],
        "out": ["file/below.onnx", "file/below/two.onnx"],
    },
    "oracle": {
        **OUT,
        "driver": ["nobody"],
        "window": ["0"],
        "horizon": ["0"],
        "alert-strengths": ["2", "nan"],
        "fatigue": ["0 0 2"],
    },
    "people delete": {
        "database": ["/no/such.db", "file"],
        "code": ["nope"],
    },
    "people export": {
        **OUT,
        "database": ["/no/such.db", "file"],
        "formats": ["nope", ""],
        "visitor": ["0", "99"],
    },
    "people traits": {
        **OUT,
        "recordings": ["", "/no/such", "file"],
        "name": ["a/b"],
        "visitor": ["nobody"],
        "driver-policy": ["nope", "/no/such", "rule"],
        "widths": ["0", "nan"],
        "seed": ["-1"],
    },
    "traits train": {
        **TRAITS,
        **OUT,
        "demonstrations": ["/no/such"],
        "preferences": ["/no/such", "file"],
    },
    "reproduce all": {**MACHINE, **RAY, **OUT, "seed": ["-1"], "quick": QUICK},
    "reproduce table": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "seeds": ["0"],
        "driver-steps": ["0"],
        "hmi-steps": ["0"],
        "quick": [*QUICK, "--hmi-steps 7"],
    },
    "reproduce driver": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "seeds": ["0"],
        "steps": ["0"],
        "snapshots": ["-1"],
        "quick": [*QUICK, "--steps 7"],
    },
    "reproduce hidden": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "seeds": ["0"],
        "driver-run": ["/no/such", "nope"],
        "driver-steps": ["0"],
        "hmi-steps": ["0"],
        "rnn-hidden-dim": ["0"],
        "quick": [*QUICK, "--hmi-steps 7"],
    },
    "reproduce identify": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "driver-run": ["/no/such", "nope"],
        "driver-steps": ["0"],
        "windows": ["7"],
        "strangers": ["2"],
        "quick": [*QUICK, "--windows 9"],
    },
    "reproduce adapt": {
        **MACHINE,
        **RAY,
        **OUT,
        "driver-run": ["/no/such"],
        "drives": ["0"],
        "updates": ["0"],
        "strangers": ["0"],
        "types": ["0"],
        "rounds": ["0"],
        "rnn-hidden-dim": ["0"],
        "traits": ["/no/such", "trained:homer"],
        "seed": ["-1"],
        "seeds": ["0"],
        "hidden": ["/no/such"],
        "quick": [*QUICK, "--drives 7"],
        **within("evaluation", ADAPT),
    },
    "reproduce traits": {
        **MACHINE,
        **RAY,
        **OUT,
        "driver-run": ["/no/such"],
        "driver-steps": ["0"],
        "demonstrated": ["0"],
        "strangers": ["1"],
        "population": ["2"],
        "seed": ["-1"],
        "seeds": ["0"],
        "quick": [*QUICK, "--seeds 7"],
        **within("learn", TRAITS),
        **within("evaluation", ASSESS),
    },
    "reproduce graded": {
        **MACHINE,
        **RAY,
        **OUT,
        **SIZES,
        "seeds": ["0"],
        "hmi-steps": ["0"],
        "quick": [*QUICK, "--hmi-steps 7"],
    },
    "reproduce shifts": {
        **MACHINE,
        **RAY,
        **OUT,
        "driver-run": ["/no/such", "nope", "trained:homer"],
        "traits-model": ["/no/such", "trained:driver"],
        "shifts": ["nope", "rule-driver", "none none"],
        "fitted": ["2"],
        "strangers": ["2", "9"],
        "posteriors": ["2", "301"],
        "windows": ["1"],
        **within("sampling", SAMPLING),
        "seed": ["-1"],
        "quick": [*QUICK, "--fitted 7"],
    },
    "reproduce ablations": {
        **MACHINE,
        **RAY,
        **OUT,
        "driver-run": ["/no/such", "nope", "trained:homer"],
        "variants": ["nope", "latent-2", "baseline baseline"],
        "strangers": ["1"],
        "windows": ["1", "7"],
        "judged": ["3"],
        "named": ["23"],
        "average-updates": ["-1"],
        "encoder-updates": ["0"],
        "drivers-per-update": ["1"],
        "posteriors": ["2", "501"],
        "recorded-seed": ["-1"],
        "seed": ["-1"],
        "seeds": ["0"],
        "quick": [*QUICK, "--seeds 7"],
    },
    "reproduce unsupervised": {
        **MACHINE,
        **RAY,
        **OUT,
        "driver-run": ["/no/such", "nope", "trained:homer"],
        "ways": ["nope", "paper paper"],
        "demonstrated": ["0", "1000"],
        "steps": ["0"],
        "rounds": ["0"],
        "imitation-updates": ["0"],
        "recorded-seed": ["-1"],
        "seed": ["-1"],
        "seeds": ["0"],
        "quick": [*QUICK, "--seeds 7"],
    },
    "reproduce map": {
        **MACHINE,
        **RAY,
        **OUT,
        "windows": ["0", "7 7"],
        "window": ["0"],
        "shares": ["2", "nan", "0.5 0.5"],
        "revealing": ["nan"],
        "etas": ["-1", "0.1 0.1"],
        "horizon": ["0", "1000000"],
        "seen-cells": ["0"],
        "hidden-cells": ["0"],
        "points": ["1"],
        "quick": ["nope", "--points 7"],
    },
    "reproduce protocols": COMPARE,
    "reproduce ship": {
        "run": ["/no/such", "nope"],
        "compare": ["/no/such", "nope"],
        "only": ["nope"],
        "out": ["file", "file/below"],
        "report": ["file", "file/below"],
    },
    "reproduce sweep": {
        **MACHINE,
        **RAY,
        **OUT,
        "protocols": ["nope", "joint joint"],
        "over": ["steps", "steps=0"],
        "seeds": ["0"],
        "seed": ["-1"],
        "episodes": ["0"],
        "drivers": ["nobody", "homer homer"],
        "quick": QUICK,
    },
    "sweep": {
        "PROTOCOLS": ["nope"],
        **MACHINE,
        **RAY,
        **OUT,
        "dry-run": FLAG,
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
        "clip": FLAG,
    },
    "train two-stage": {
        **TRAIN,
        "hmi-for": ["nobody"],
        "driver-policy": ["nope", "/no/such"],
        "driver-steps": ["-1"],
        "hmi-steps": ["-1"],
        "driver-reward": ["nope"],
        "hmi-reward": ["nope"],
    },
    "train alternating": {
        **TRAIN,
        "rounds": ["0"],
        "driver-steps": ["0"],
        "hmi-steps": ["0"],
        "driver-reward": ["nope"],
        "hmi-reward": ["nope"],
    },
    "train joint": {**TRAIN, **ANCHOR, "steps": ["0"], "reward": ["nope"]},
    "train simultaneous": {**TRAIN, **ANCHOR, "steps": ["0"], "reward": ["nope"]},
    "train fine-tune": {
        **TRAIN,
        **ANCHOR,
        "driver-steps": ["0"],
        "hmi-steps": ["-1"],
        "together-steps": ["0"],
        "together-progress": ["nan", "2"],
        "driver-reward": ["nope"],
        "hmi-reward": ["nope"],
        "together-reward": ["nope"],
    },
    "traits evaluate": {
        **OUT,
        **ASSESS,
        "runs": ["", "/no/such"],
        "demonstrations": ["/no/such"],
        "population": ["/no/such"],
        "driver-policy": ["/no/such", "nope"],
    },
    "traits posterior": {
        **OUT,
        "demonstrations": ["/no/such"],
        "cases": ["nope"],
        "windows": ["0", "99"],
        "seconds": ["0", "nan"],
        "driver-policy": ["/no/such", "nope"],
        **within("sampling", SAMPLING),
        "seed": ["-1"],
    },
    "play": {
        **TEAM,
        "database": ["file/people.db"],
        "host": ["a/b", "no.such.host.invalid"],
        "port": ["-1", "65536"],
        "base-path": ["hmi", "/../x"],
        "trust-proxy": FLAG,
        "seat": ["passenger"],
        "hmis": ["siren", "/no/such", ""],
        "driver-policies": ["ace", "/no/such"],
        "drivers": ["nobody"],
        "trips": ["0"],
        "trial-trips": ["0"],
        "seed": ["-1"],
        "max-visitors": ["0"],
        "open": FLAG,
    },
    "study make": {
        **OUT,
        "drivers": ["nobody", "lisa lisa"],
        "controls": ["lisa@nope", "nobody"],
        "policy": ["nope", "/no/such"],
        "hmi": ["siren", "/no/such"],
        "clips": ["1"],
        "shown": ["0", "99"],
        "contrasts": ["nope", "safe:lisa>nobody", "safe:lisa>lisa"],
        "seed": ["-1"],
        "duration": ["nan", "-1", "0.3"],
        "vehicles": ["-1 5", "3 1"],
        "format": ["nope"],
        "width": ["0"],
        "frames-per-step": ["0"],
        "keep-ids": FLAG,
        "completion-code": ["a/b"],
        "return-address": ["http://panel.org", "nope"],
        "consent": ["/no/such", "file"],
        "quick": ["nope", "--clips 7"],
    },
    "study serve": {
        "study": ["/no/such", "file"],
        "database": ["/no/such/people.db"],
        "host": ["a/b"],
        "port": ["-1", "99999"],
        "base-path": ["nope", "/a//b"],
        "trust-proxy": FLAG,
        "max-visitors": ["0"],
        "requests": ["0", "nan"],
        "messages": ["0", "nan"],
        "message-size": ["0"],
        "most-raters": ["0"],
    },
    "study analyse": {
        **OUT,
        "study": ["/no/such", "file"],
        "answers": ["/no/such.db", "file", "/no/such.csv"],
        "margin": ["-1", "nan"],
    },
    "study power": {
        **OUT,
        "study": ["/no/such", "file"],
        "raters": ["1", "", "50 20"],
        "studies": ["1"],
        "power": ["0.2", "nan"],
        "margin": ["-1", "nan"],
        "seed": ["-1"],
        "plan.effect": ["-1", "nan"],
        "plan.rater": ["-1", "nan"],
        "plan.clip": ["-1", "nan"],
        "plan.rater-driver": ["-1", "nan"],
        "plan.residual": ["0", "nan"],
        "plan.middle": ["0", "nan"],
        "plan.careless": ["1", "nan"],
    },
    "watch": {
        **TEAM,
        "perceived": FLAG,
        "driver": ["nobody"],
        "hmi": ["siren", "/no/such"],
        "policy": ["ace", "/no/such"],
        "seed": ["-1"],
        "out": ["clip.txt", "file/clip.gif"],
    },
}


PRESET = {
    "sweep": {"PROTOCOLS": "joint two-stage"},
    "export": {"policy": "trained:homer"},
    "people delete": {"database": "PEOPLE", "code": "K7QF2M9PXW4ZH8TD"},
    "people export": {"database": "PEOPLE"},
    "people traits": {"recordings": "TRIP"},
    "play": {"port": "0"},
    "reproduce ship": {"out": "out", "run": "/no/such"},
    "study serve": {"study": "STUDY", "database": "people.db", "port": "0"},
    "study analyse": {"study": "STUDY", "answers": "ANSWERS"},
    "study power": {"study": "STUDY"},
    "traits train": {"demonstrations": "DATA"},
    "traits evaluate": {"demonstrations": "DATA", "runs": "MODEL"},
    "traits posterior": {"demonstrations": "DATA"},
    "watch": {"out": "clip.gif"},
}
"""Options that a command needs anyway, so that nothing else is wrong with it."""
POSITIONAL = ("runs", "PROTOCOLS", "database", "code", "recordings", "study", "answers")


def is_positional(command: str, name: str) -> bool:
    """Whether an argument is given without its name."""
    return name in POSITIONAL and (command, name) != ("play", "database")


@dataclass(frozen=True)
class Case:
    command: str
    option: str
    value: str

    def arguments(self, places: dict[str, str]) -> list[str]:
        """Words of the command line, with the places of what lies elsewhere."""
        options = PRESET.get(self.command, {}) | {self.option: self.value}
        given = [
            value if is_positional(self.command, name) else f"--{name} {value}"
            for name, value in options.items()
        ]
        words = " ".join([self.command, *given]).split()
        return [places.get(word, word) for word in words]

    def is_named(self, error: str) -> bool:
        """Whether an error is about this option: it names the option or the value."""
        name = self.option.rpartition(".")[2]
        names = [name, name.replace("-", "_"), name.replace("-", " "), name.removesuffix("s")]
        words = re.findall(r"[A-Za-z][\w.-]+", self.value)
        return any(word in error for word in (*names, *words))


OF_COMMANDS = {"out", "workers", "processes", "quick", "seed"}
"""Options that each command reads itself; the others belong to settings that several share."""


def cases(first: bool) -> dict[str, list[Case]]:
    """Cases by command: one of each option, with the first command that has it; or all others."""
    found: dict[str, list[Case]] = {}
    tried = set()
    for command, options in BAD.items():
        found[command] = []
        for option, values in options.items():
            kind = option.rpartition(".")[2], tuple(values)
            is_new = kind not in tried or option in OF_COMMANDS
            tried.add(kind)
            for number, value in enumerate(values):
                if first == (is_new and number == 0):
                    found[command].append(Case(command, option, value))
    return found


FIRST, OTHERS = cases(first=True), cases(first=False)


@pytest.fixture(scope="module")
def places(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """A dataset, and a model that has learned from it, by the words that stand for them."""
    for package in ("torch", "rsl_rl", "pyarrow", "sklearn", "onnx", "ray"):
        pytest.importorskip(package)
    from demonstrations import made_up
    from people.study.studies import a_study
    from people.trips import a_trip
    from trait_models import untrained

    from hmi_marl.demonstrations.parquet import OBSERVED, write_demonstrations

    folder = tmp_path_factory.mktemp("made")
    data = made_up([20] * 16, driver=[0, 1] * 8, names=("lisa", "homer"))
    write_demonstrations(folder / "data", data)
    model = untrained(data.observed.layout)
    training = {
        "settings": {"supervision": "id", "held_out": 0.2, "seed": 0},
        "demonstrations": sha256_of(folder / "data" / OBSERVED),
    }
    save_traits(folder / "model", replace(model.card, training=training), model.weights)
    Store(folder / "people.db").close()
    write_json(folder / "trip.json", a_trip(steps=3).record().to_json())
    study = a_study(folder / "study")
    write_answers(folder / "answers.csv", simulated_answers(study, 4, Plan()))
    named = {
        "DATA": "data",
        "MODEL": "model",
        "PEOPLE": "people.db",
        "TRIP": "trip.json",
        "STUDY": "study",
        "ANSWERS": "answers.csv",
    }
    return {word: str(folder / name) for word, name in named.items()}


@pytest.fixture
def in_an_empty_folder(
    places: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """With a file in the way of ``--out file``, and no worker process."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").touch()
    monkeypatch.delenv("WORLD_SIZE", raising=False)

    def started(*_: object, **__: object) -> None:
        raise AssertionError("a process was started before everything was checked")

    monkeypatch.setattr(start, "SharedMemory", started)
    monkeypatch.setattr(workers, "ProcessPoolExecutor", started)
    return tmp_path


def refused(arguments: list[str]) -> object:
    """Run a command; return its status, or what would be a traceback for its user."""
    try:
        return main(arguments)
    except SystemExit as stop:
        return stop.code
    except BaseException as error:
        return repr(error)


def check(
    several: list[Case], places: dict[str, str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Check that each is refused in one line that names it, soon, and leaves nothing behind."""
    wrong = []
    for case in several:
        began = time.monotonic()
        status = refused(case.arguments(places))
        took, printed = time.monotonic() - began, capsys.readouterr()
        left = sorted(str(path) for path in folder.rglob("*") if path.name != "file")
        if (
            status != 2
            or left
            or printed.out
            or not re.fullmatch(r"hmi-marl: [^\n]+\n", printed.err)
            or not case.is_named(printed.err)
            or took > LONGEST
        ):
            words = " ".join(case.arguments({}))
            wrong.append((words, status, left[:3], printed.err[-300:], took))
    assert not wrong, "\n".join(map(str, wrong))


@pytest.mark.parametrize("command", BAD)
def test_a_bad_value_leaves_one_line_and_nothing_else(
    command: str,
    places: dict[str, str],
    in_an_empty_folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    check(FIRST[command], places, in_an_empty_folder, capsys)


@pytest.mark.slow  # what only repeats the kind of value
@pytest.mark.parametrize("command", BAD)
def test_other_bad_values_leave_one_line_and_nothing_else(
    command: str,
    places: dict[str, str],
    in_an_empty_folder: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    check(OTHERS[command], places, in_an_empty_folder, capsys)


COMMANDS = [path for each in SUBCOMMANDS for path, _ in each.leaves()]


def test_every_command_has_bad_values() -> None:
    assert sorted(BAD) == sorted(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_a_bad_value(
    command: str, places: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert refused([*command.split(), "--help"]) == 0
    shown = re.findall(r"^[ │]{1,3}(?:-\w, )?--(\w[\w.-]*)", capsys.readouterr().out, re.MULTILINE)
    options = set(shown) - {"help"}
    assert {name for name in BAD[command] if not is_positional(command, name)} == options
    assert all(BAD[command].values())
