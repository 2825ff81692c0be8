"""Measure the written passes of a recurrent layer against torch's, which autograd differentiates.

Forward and backward over the steps of a mini-batch of ``hmi-marl compare`` with attention hidden:
by default 100 steps of 32 teams, 20 inputs and 32 units. The two alternate, on one thread; the
ratio is the median over pairs, which follow each other and so meet the same machine.

Needs one extra: pip install 'hmi-marl[train]'

Run: python benchmarks/recurrent.py
"""

import argparse
import time
from collections.abc import Callable

import numpy as np
import torch

from hmi_marl.training.ppo.gru import GRU


def seconds(call: Callable[[], object]) -> float:
    """Return how long a call takes."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    """Time both in turns, and print the ratio."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_Raw)
    parser.add_argument("--steps", type=int, default=100, help="steps of an episode")
    parser.add_argument("--teams", type=int, default=32, help="teams side by side")
    parser.add_argument("--inputs", type=int, default=20, help="inputs of the layer")
    parser.add_argument("--units", type=int, default=32, help="units of the layer")
    parser.add_argument("--pairs", type=int, default=200, help="pairs of measurements")
    args = parser.parse_args()
    torch.set_num_threads(1)
    torch.manual_seed(0)
    module = torch.nn.GRU(args.inputs, args.units)
    weights = list(module.parameters())
    inputs = torch.randn(args.steps, args.teams, args.inputs)
    carried = torch.ones(args.steps, args.teams)
    carried[0] = 0.0
    gradient = torch.randn(args.steps, args.teams, args.units)
    gru, into = GRU(module), [torch.empty_like(weight) for weight in weights]

    def written() -> None:
        with torch.no_grad():
            gru.backward(gru.forward(inputs, carried)[1], gradient, into)

    def by_autograd() -> None:
        torch.autograd.grad(module(inputs)[0], weights, gradient)

    times = np.array([(seconds(by_autograd), seconds(written)) for _ in range(args.pairs + 1)])[1:]
    low, ratio, high = np.quantile(times[:, 0] / times[:, 1], [0.25, 0.5, 0.75])
    autograd, ours = np.median(times, axis=0) * 1000
    print(f"torch's layer with autograd {autograd:.2f} ms, written passes {ours:.2f} ms")
    print(f"ratio {ratio:.2f}, quartiles {low:.2f} and {high:.2f}, of {args.pairs} pairs")


class _Raw(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    """Keep the lines of the description, and show defaults."""


if __name__ == "__main__":
    main()
