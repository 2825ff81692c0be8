"""rsl_rl's runner: learns with our heads and exports what was learned by its own means."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")

import hmi_marl  # noqa: E402

pytestmark = [  # of torch's exporters, which rsl_rl calls
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
    pytest.mark.filterwarnings("ignore::UserWarning"),
]
SEATS = {"driver": (1.0,), "vehicle_ai": (0.5, 1.0), "team": (0.5, 1.0)}
"""With the strengths of alert that there are."""


def runner_of(seat: str, memory: bool) -> Any:
    from rsl_rl.runners import OnPolicyRunner

    from hmi_marl.training.ppo.heads import IntentThenAlert, OneAction

    teams = hmi_marl.make_vec(
        6, seat=seat, world="highway", duration=2.0, alert_strengths=SEATS[seat]
    )
    if seat == "team":
        head = {"class_name": IntentThenAlert, "alerts": teams.action_sizes[1]}
    else:
        head = {"class_name": OneAction, "choices": teams.action_sizes[0]}
    network = {"class_name": "MLPModel", "hidden_dims": [16], "activation": "elu"}
    remembers = {"class_name": "RNNModel", "rnn_type": "gru", "rnn_hidden_dim": 8}
    settings = {
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 1, "num_mini_batches": 1},
        "actor": network
        | (remembers if memory else {})
        | {"distribution_cfg": head, "obs_normalization": True},
        "critic": network,
        "obs_groups": {"actor": [group(seat)], "critic": ["critic"]},
        "num_steps_per_env": 4,
        "save_interval": 100,
    }
    torch.manual_seed(1)
    return OnPolicyRunner(teams, settings)


def group(seat: str) -> str:
    return "driver" if seat == "driver" else "vehicle_ai"


@pytest.mark.parametrize(
    ("seat", "memory"),
    [
        ("driver", False),
        ("team", True),
        pytest.param("vehicle_ai", True, marks=pytest.mark.slow),
        pytest.param("team", False, marks=pytest.mark.slow),
        pytest.param("driver", True, marks=pytest.mark.slow),
        pytest.param("vehicle_ai", False, marks=pytest.mark.slow),
    ],
)
def test_the_runners_own_exports_act_as_the_policy_does(
    seat: str, memory: bool, tmp_path: Path
) -> None:
    from onnx.reference import ReferenceEvaluator

    runner = runner_of(seat, memory)
    runner.learn(2)
    runner.export_policy_to_jit(str(tmp_path))
    runner.export_policy_to_onnx(str(tmp_path))
    scripted = torch.jit.load(str(tmp_path / "policy.pt"))
    exported = ReferenceEvaluator(str(tmp_path / "policy.onnx"))
    seen = runner.env.get_observations()
    with torch.inference_mode():
        runner.alg.get_policy().reset()
        expected = runner.get_inference_policy()(seen)
    columns = 2 if seat == "team" else 1
    assert expected.shape == (6, columns)
    for row, action in zip(seen[group(seat)], expected, strict=True):
        scripted.reset()  # it is for one team, as the exported model is
        torch.testing.assert_close(scripted(row[None])[0], action, rtol=0, atol=0)
        inputs = {"obs": row[None].numpy()}
        if memory:
            inputs["h_in"] = np.zeros((1, 1, 8), np.float32)
        np.testing.assert_array_equal(exported.run(None, inputs)[0][0], action.numpy())
