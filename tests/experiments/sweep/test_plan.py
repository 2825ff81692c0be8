import pytest

from hmi_marl.experiments.sweep.figure import axis_of
from hmi_marl.experiments.sweep.plan import Combination, plan_runs, varying


def plan(*over: str, protocols=("two-stage", "joint"), seeds=2):
    return plan_runs(protocols, over, seeds, 0)


def test_every_combination_has_a_run_for_each_seed():
    runs = plan("steps=1e6,2e6", "critic=own,team", "two-stage:hmi_for=homer,lisa")
    assert len(runs) == (2 * 2 * 2 + 2 * 2) * 2
    assert len({run.name for run in runs}) == len(runs)
    assert len({(run.combination.label, run.settings) for run in runs}) == len(runs)
    assert [run.number for run in runs[:2]] == [0, 1]
    assert {run.settings.seed for run in runs if run.number == 0} == {0}


def test_a_larger_sweep_keeps_the_folders_of_a_smaller_one():
    small = plan("steps=1e6", "critic=own")
    large = plan("critic=own,team", "steps=1e6,2e6", seeds=3)
    by_name = {run.name: run.settings for run in large}
    assert [by_name[run.name] for run in small] == [run.settings for run in small]


def test_long_and_odd_values_make_plain_names():
    odd = Combination("two-stage", {"driver_policy": "runs/a b", "hmi_for": "x:0.1,1,0,1"})
    other = Combination("two-stage", {"driver_policy": "runs/a-b", "hmi_for": "x:0.1,1,0,1"})
    assert odd.name != other.name
    assert set("/ :,").isdisjoint(odd.name)
    long = Combination("joint", {"drivers": tuple(f"driver-{k}" for k in range(50))})
    assert len(long.name) <= 100


def test_steps_are_those_of_whole_batches():
    (run,) = plan("steps=1", "num_teams=16", "duration=2", protocols=("joint",), seeds=1)
    assert run.steps == 16 * 10


@pytest.mark.parametrize(
    ("over", "message"),
    [
        (["ppo.gamma=0.9,1.5"], r"two-stage with ppo\.gamma = 1\.5: gamma lies in \[0, 1\], but"),
        (["steps=1e6", "steps=2e6"], "steps is swept twice for two-stage"),
        (["steps=1e6..2e6/501", "ppo.gamma=0.9..0.99/100"], "at most 10000 runs, but .* 200400"),
        (["ppo.num_mini_batches=600"], "two-stage with .* = 600: cannot split 512 teams"),
    ],
)
def test_the_combination_that_does_not_fit_is_named(over, message):
    with pytest.raises(ValueError, match=message):
        plan(*over)


def test_the_axis_is_the_number_with_the_most_values():
    runs = plan("steps=1e6,2e6,3e6", "ppo.gamma=0.9,0.95", "critic=own,team", "num_teams=512")
    combinations = [run.combination for run in runs]
    assert varying(combinations) == ["steps", "ppo.gamma", "critic"]
    assert axis_of(combinations) == "steps"
    assert axis_of([run.combination for run in plan("critic=own,team")]) is None
