"""AgileRL: its vector of PettingZoo in processes, and IPPO over it."""

import pytest
from fresh import run, run_example

pytest.importorskip("agilerl")

VECTOR = """
import functools, numpy
from agilerl.vector.pz_async_vec_env import AsyncPettingZooVecEnv
from hmi_marl import merge_v0

if __name__ == "__main__":
    make = functools.partial(merge_v0.parallel_env, world={world!r}, duration=2.0)
    alone = make()  # what a process did before it forked
    alone.reset(seed=3)
    cars = AsyncPettingZooVecEnv([make, make])
    seen, _ = cars.reset(seed=3)
    for step in range(5):
        actions = {{"driver": numpy.array([step % 5, 1]), "vehicle_ai": numpy.array([1, 0])}}
        seen, rewards, *_ = cars.step(actions)
        expected, reward, *_ = alone.step({{"driver": step % 5, "vehicle_ai": 1}})
        for agent in expected:
            numpy.testing.assert_array_equal(seen[agent][0], expected[agent])
            numpy.testing.assert_allclose(rewards[agent][0], reward[agent], rtol=1e-6)
    cars.close()
    print("equal")
"""


@pytest.mark.parametrize("world", ["highway", "batched"])
def test_processes_give_what_one_gives(world: str) -> None:
    assert "equal" in run("-c", VECTOR.format(world=world))


@pytest.mark.parametrize("world", ["highway", "batched"])
def test_the_example_learns(world: str) -> None:
    size = ["--steps", "40", "--cars", "2", "--batch", "10", "--duration", "2"]
    printed = run_example("agilerl_ippo", "--world", world, *size)
    assert "return of each agent: [{'driver':" in printed
