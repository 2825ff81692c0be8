"""Gymnasium's own vectors, and a loop in the manner of CleanRL over them."""

import pytest
from fresh import run, run_example

ASYNC = """
import gymnasium, numpy, hmi_marl
if __name__ == "__main__":
    settings = {{"driver": "homer", "world": {world!r}, "duration": 2.0}}
    here = gymnasium.make({seat!r}, **settings)  # what a process did before it forked
    here.reset(seed=0)
    here.step(1)
    seen = []
    for mode in ("sync", "async"):
        cars = gymnasium.make_vec({seat!r}, num_envs=2, vectorization_mode=mode, **settings)
        steps = [cars.reset(seed=3)[0]]
        steps += [cars.step(numpy.array([1, 0]))[0] for _ in range(12)]
        seen.append(numpy.stack(steps))
        cars.close()
    numpy.testing.assert_array_equal(*seen)
    print("equal")
"""
SEATS = ("hmi_marl/MergeDriver-v0", "hmi_marl/MergeHMI-v0")


@pytest.mark.parametrize("seat", SEATS)
@pytest.mark.parametrize("world", ["highway", "batched"])
def test_processes_give_what_one_gives(world: str, seat: str) -> None:
    assert run("-c", ASYNC.format(world=world, seat=seat)) == "equal\n"


@pytest.mark.parametrize("vector", ["sync", "async"])
@pytest.mark.parametrize("world", ["highway", "batched"])
@pytest.mark.parametrize("seat", ["MergeDriver", "MergeHMI"])
def test_cleanrls_manner(seat: str, world: str, vector: str) -> None:
    pytest.importorskip("torch")
    size = ["--cars", "2", "--batch", "16", "--steps", "64", "--duration", "2"]
    printed = run_example(
        "cleanrl_ppo", "--seat", seat, "--world", world, "--vector", vector, *size
    )
    assert printed.count("mean return") == 2
    assert "nan" not in printed
