"""Every number of every settings dataclass has a range with both ends, and keeps to it."""

import importlib
import inspect
import math
import pkgutil
import types
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

import hmi_marl
from hmi_marl import Driver, RewardWeights, TeamConfig, make_vec
from hmi_marl.agents.adaptive.hmis import make_adaptive
from hmi_marl.agents.hmis import RandomAlert
from hmi_marl.checks import Checked, allowed
from hmi_marl.envs.scene import Scene
from hmi_marl.envs.streams import check_seed
from hmi_marl.envs.teaming import Teaming
from hmi_marl.envs.worlds import make_world
from hmi_marl.exact import oracle
from hmi_marl.exact.bayes_filter import BayesFilter
from hmi_marl.exact.hidden_attention import solve_belief
from hmi_marl.workers import check_workers

UNBOUNDED = {
    "PolicyCard.reads": "sizes of parts, which are compared with the layout",
    "TraitCard.reads": "the same",
    "EvidenceCard.reads": "the same",
}
"""Numeric fields whose annotation has no range, and why."""

NO_SETTINGS = {
    "hmi_marl.people.trip.Road": "made from a Scene, which checks",
    "hmi_marl.people.play.visits.Visit": "state of a visit",
    "hmi_marl.people.study.ratings.LeftOut": "results",
    "hmi_marl.commands": "as typed; what they set up is checked",
    "hmi_marl.envs.config.TeamSettings": "as typed; TeamConfig checks",
    "hmi_marl.experiments.metrics_table.table.TableSettings": "as typed; TableConfig checks",
    "hmi_marl.experiments.experiment.Place": "made by commands, whose workers are checked",
    "hmi_marl.experiments.protocols.results.Comparison": "the same",
    "hmi_marl.experiments.protocols.task_plan.TaskPlan": "made by ComparisonSettings, which check",
    "hmi_marl.experiments.protocols.arms": "made by a TaskPlan from checked settings",
    "hmi_marl.experiments.graded_alerts.Case": "constants of the experiment",
    "hmi_marl.training.protocols.settings.Phase": "made by protocols from checked settings",
    "hmi_marl.training.protocols.settings.Budget": "the same",
    "hmi_marl.training.ppo.shards.Shards": "the same",
    "hmi_marl.training.runs.processes.Processes": "read from torchrun's environment",
    "hmi_marl.training.runs.checkpoint.Checkpoint": "state of a run",
    "hmi_marl.demonstrations.recording.Tally": "results",
    "hmi_marl.reporting.statistics.Estimate": "the same",
    "hmi_marl.reporting.verdicts": "the same",
    "hmi_marl.envs.render.TeamStatus": "results",
    "hmi_marl.experiments.metrics_table.table.Cell": "results",
    "hmi_marl.experiments.speed.bench._Contestant": "results",
    "hmi_marl.experiments.trait_shifts.scoring.Estimates": "results",
    "hmi_marl.experiments.trait_ablations.variants.Variant": "constants of the experiment",
}
"""Dataclasses with numbers by default that nobody sets, and why."""

EXAMPLES = {
    "Decide": {"step": 0, "action": 1, "away": 0},
    "Found": {"puzzle": 0, "number": 47},
    "TripRecord": {
        "config": TeamConfig(driver=("lisa",)),
        "seed": 1,
        "seat": "driver",
        "kind": "free",
        "partner": "optimal",
        "intents": (1,),
        "alerts": (0,),
        "looking_away": (0,),
        "crashed": False,
    },
    "StudyClip": {
        "name": "0a1b.mp4",
        "condition": "lisa",
        "seed": 1,
        "seconds": 20.0,
        "crashed": False,
        "distracted": 0.2,
        "sha256": "",
    },
    "CheckClip": {"name": "0a1b.mp4", "answer": 2, "sha256": ""},
    "PosteriorEvaluation": {"demonstrations": Path("data")},
    "Case": {"window": 7, "weights": "paper", "horizon": 100, "revealing": 0.35},
    "Driver": {"name": "mona", "beta": 0.1, "alpha": 0.2, "eta": 0.3, "inflation": 4.0},
    "Uniform": {"low": 0.5, "high": 1.0},
    "Choice": {"values": (0.5, 1.0)},
    "PolicyCard": {"seat": "driver", "reads": (("speed", 1),)},
    "TraitCard": {"reads": (("speed", 1),)},
    "EvidenceCard": {
        "reads": (("intended_action", 5),),
        "encoder": "",
        "features": 2,
        "context": 2,
    },
    "TableConfig": {"hmis": ("never",)},
    "_Header": dict.fromkeys(("format", "sha256", "settings"), "")
    | {"phase": 0, "iteration": 0, "steps": 0, "seconds": 0.0, "curve": []},
    "TrainTraits": {},
}
"""Arguments of settings that do not work by default, or are slow."""

ODD = [
    math.nan,
    math.inf,
    -math.inf,
    10**400,
    -(10**400),
    1e308,
    -1,
    0,
    1,
    True,
    "1",
    None,
    [1],
    1j,
    np.float64(math.nan),
    np.float64(1.0),
    np.int64(1),
    np.array([1, 2]),
    object(),
]


def dataclasses_of_the_package() -> list[type]:
    found = {}
    for module in pkgutil.walk_packages(hmi_marl.__path__, "hmi_marl."):
        if module.name.endswith("__main__"):
            continue
        for kind in vars(importlib.import_module(module.name)).values():
            if inspect.isclass(kind) and is_dataclass(kind) and kind.__module__ == module.name:
                found[f"{kind.__module__}.{kind.__qualname__}"] = kind
    return list(found.values())


def bare(hint: Any) -> bool:
    """Whether a number may stand here: int or float, alone, in unions or in tuples."""
    if hint in (int, float):
        return True
    inner = get_origin(hint) in (tuple, Union, types.UnionType) or hasattr(hint, "__metadata__")
    return inner and any(bare(part) for part in get_args(hint))


def numeric(kind: type) -> dict[str, Any]:
    hints = get_type_hints(kind, include_extras=True)
    return {f.name: hints[f.name] for f in fields(kind) if f.init and bare(hints[f.name])}


ALL = dataclasses_of_the_package()
SETTINGS = [kind for kind in ALL if issubclass(kind, Checked) and numeric(kind)]
FIELDS = [(kind, name) for kind in SETTINGS for name in numeric(kind)]


def name_of(kind: type, field: str = "") -> str:
    return f"{kind.__module__}.{kind.__qualname__}{field and '.'}{field}"


def test_all_settings_check_themselves():
    forgotten = [
        name_of(kind)
        for kind in ALL
        if not issubclass(kind, Checked)
        and not any(name_of(kind).startswith(known) for known in NO_SETTINGS)
        and any(
            field.name in numeric(kind) and field.default is not MISSING for field in fields(kind)
        )
    ]
    assert forgotten == []
    assert len(SETTINGS) > 30


def test_every_number_has_a_range_with_both_ends():
    for kind, field in FIELDS:
        words = allowed(numeric(kind)[field])
        assert words or f"{kind.__name__}.{field}" in UNBOUNDED, name_of(kind, field)
        assert "inf" not in words
        assert "nan" not in words


def numbers_in(value: Any) -> list[Any]:
    if isinstance(value, tuple):
        return [number for each in value for number in numbers_in(each)]
    return [] if value is None else [value]


@pytest.mark.parametrize("kind", SETTINGS, ids=name_of)
def test_odd_values_are_refused_in_one_line_or_work(kind):
    base = kind(**EXAMPLES.get(kind.__name__, {}))
    outcomes = set()
    for field in numeric(kind):
        if f"{kind.__name__}.{field}" in UNBOUNDED:
            continue
        for value in ODD:
            try:
                kept = getattr(replace(base, **{field: value}), field)
            except (ValueError, TypeError) as error:
                outcomes.add("refused")
                text = str(error)
                assert field in text.replace("-", "_"), (field, value, text)
                assert "\n" not in text
                assert len(text) < 300
            else:
                outcomes.add("kept")
                assert not isinstance(value, (str, complex, bool)), (field, value)
                for number in numbers_in(kept):
                    assert type(number) in (int, float), (field, value)
                    assert abs(number) < 2**64
    assert outcomes in ({"refused", "kept"}, {"refused"}, set())


HIDDEN = TeamConfig(ai_sees_attention=False)
SMALL = {"world": "highway", "duration": 0.2, "scene": Scene(vehicles=1)}
CALLS = {
    "num_teams": [lambda v: make_vec(v, **SMALL), lambda v: Teaming(TeamConfig(), v)],
    "num_worlds": [lambda v: make_world("highway", TeamConfig().scene, v)],
    "seed": [lambda v: make_vec(1, seed=v, **SMALL), check_seed],
    "threads": [lambda v: make_world("highway", TeamConfig().scene, 1, 1 if v is None else v)],
    "workers": [lambda v: check_workers(1 if v is None else v)],
    "window": [
        lambda v: oracle.solve_alerts("lisa", v, 2),
        lambda v: oracle.reachable("lisa", window=v, horizon=2),
        lambda v: solve_belief("lisa", v, 2, RewardWeights()),
        lambda v: BayesFilter([Driver("a", 0.1, 0.2, 0.3, 4)], v, 1),
    ],
    "horizon": [
        lambda v: oracle.evaluate(0.5, "lisa", 2, v),
        lambda v: oracle.alert_losses("lisa", 2, v),
        lambda v: solve_belief("lisa", 2, v, RewardWeights()),
    ],
    "alert": [
        lambda v: oracle.evaluate(v, "lisa", 2, 2),
        lambda v: oracle.solve_alerts("lisa", strengths=(v,), window=2, horizon=2),
    ],
    "revealing": [lambda v: solve_belief("lisa", 2, 2, RewardWeights(), v)],
    "count": [lambda v: BayesFilter(["lisa"], 2, v)],
    "rate": [RandomAlert],
    "caution": [lambda v: make_adaptive("expected", HIDDEN, exact=True, caution=v)],
    "change_rate": [lambda v: make_adaptive("expected", HIDDEN, exact=True, change_rate=v)],
}
"""Calls of public functions with one number, by a part of its name."""


@pytest.mark.parametrize("name", CALLS)
def test_odd_arguments_are_refused_in_one_line_or_work(name):
    for call in CALLS[name]:
        outcomes = [outcome(call, value) for value in ODD]
        refused = [text for text in outcomes if text is not None]
        assert len(refused) > 10
        for text in refused:
            assert name in text
            assert "\n" not in text
            assert len(text) < 300


def outcome(call, value) -> str | None:
    """Text of the error, or None."""
    try:
        call(value)
    except (ValueError, TypeError) as error:
        return str(error)
    return None
