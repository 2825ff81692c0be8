"""Speed of highway-env, the batched world and the teams on it, as ratios in one run."""

from hmi_marl.experiments.speed.bench import BenchConfig, Measured, bench, measurements
from hmi_marl.experiments.speed.report import make_report

__all__ = ["BenchConfig", "Measured", "bench", "make_report", "measurements"]
