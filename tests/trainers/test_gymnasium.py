"""Gymnasium's own vectors, and a loop in the manner of CleanRL over them."""

from itertools import product

import pytest
from fresh import ALL_THREADS, DRIVE_MANY, ROOT, run, run_each

ASYNC = (
    DRIVE_MANY.replace("{", "{{").replace("}", "}}")
    + """
import gymnasium, numpy, hmi_marl
from itertools import product
if __name__ == "__main__":
    alone = drive_many()  # what a process did, in all its threads, before it forked
    for world, seat in product(("highway", "batched"), {seats}):
        settings = {{"driver": "homer", "world": world, "duration": 2.0}}
        here = gymnasium.make(seat, **settings)  # and in one
        here.reset(seed=0)
        here.step(1)
        seen = []
        for mode in ("sync", "async"):
            cars = gymnasium.make_vec(seat, num_envs=2, vectorization_mode=mode, **settings)
            steps = [cars.reset(seed=3)[0]]
            steps += [cars.step(numpy.array([1, 0]))[0] for _ in range(12)]
            seen.append(numpy.stack(steps))
            cars.close()
        numpy.testing.assert_array_equal(*seen)
        print("equal", world, seat)
    assert drive_many() == alone
"""
)
SEATS = ("hmi_marl/MergeDriver-v0", "hmi_marl/MergeHMI-v0")


def test_processes_give_what_one_gives() -> None:
    assert run("-c", ASYNC.format(seats=SEATS), **ALL_THREADS).count("equal") == 4


EVERY = list(product(("MergeDriver", "MergeHMI"), ("highway", "batched"), ("sync", "async")))


@pytest.mark.slow
def test_cleanrls_manner() -> None:
    pytest.importorskip("torch")
    size = ["--cars", "2", "--batch", "16", "--steps", "64", "--duration", "2"]
    script = (ROOT / "examples" / "trainers" / "cleanrl_ppo").with_suffix(".py")
    every = [
        (script, ["--seat", seat, "--world", world, "--vector", vector, *size])
        for seat, world, vector in EVERY
    ]
    for printed in run_each(*every):
        assert printed.count("mean return") == 2
        assert "nan" not in printed
