import numpy as np
import pytest

from hmi_marl.agents import load_policy, save_policy
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import make_card
from hmi_marl.cli import main
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.observations import vehicle_ai_layout

TEAM = TeamConfig(driver="bart")


@pytest.fixture
def run(tmp_path):
    card = make_card("vehicle_ai", TEAM, NetworkConfig((8,)), knows_traits=True)
    random = np.random.default_rng(0)
    save_policy(
        tmp_path,
        card,
        {name: random.normal(size=shape).astype("f4") for name, shape in card.shapes.items()},
    )
    return tmp_path


def test_a_policy_is_written_as_onnx_beside_itself(run, capsys):
    reference = pytest.importorskip("onnx.reference")
    assert main(["export", "--policy", str(run)]) == 0
    assert "vehicle_ai.onnx" in capsys.readouterr().out
    policy = load_policy(run, "vehicle_ai", TEAM)
    shape = 5, vehicle_ai_layout(TEAM).size
    observation = np.random.default_rng(1).random(shape).astype(np.float32)
    model = reference.ReferenceEvaluator(str(run / "vehicle_ai.onnx"))
    (action,) = model.run(["action"], {"observation": observation})
    policy.reset(np.arange(5, dtype=np.uint64))
    np.testing.assert_array_equal(action, policy.act(observation))


def test_one_that_came_with_the_package_is_written_here(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    monkeypatch.chdir(tmp_path)
    assert main(["export", "--policy", "trained:Homer"]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["homer.onnx"]


def test_a_seat_without_a_policy_is_told(run, capsys):
    assert main(["export", "--policy", str(run), "--seat", "driver"]) == 2
    assert "it holds one for vehicle_ai" in capsys.readouterr().err
