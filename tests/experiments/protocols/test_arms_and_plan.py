"""The plan of a comparison: tasks, arms, budgets, waves and pairs."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from hmi_marl.envs.rewards import DRIVING_TERMS, TERMS
from hmi_marl.envs.streams import part_seed
from hmi_marl.experiments.protocols.arms import MAIN, NO_TRAITS, ROBUST, RULE, TWO_STAGE, PlannedRun
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.pairs import Pair, all_pairs
from hmi_marl.experiments.protocols.plan import QUICK, ComparisonSettings, coarse
from hmi_marl.experiments.protocols.results import gradient_steps
from hmi_marl.experiments.protocols.tasks import TASKS
from hmi_marl.training.protocols.registry import compared

DEFAULT = ComparisonSettings()
SEEN, HIDDEN, PARALLEL = DEFAULT.plans()
FOLDER = Path("out")
SMALL = replace(DEFAULT, steps=200_000, budgets=(), num_teams=16, rounds=2)


def steps_of(settings) -> int:
    return sum(
        phase.iterations(settings.num_teams) * settings.num_teams * phase.team.horizon
        for phase in settings.phases()
    )


def test_every_protocol_of_a_task_takes_as_many_environment_steps():
    for plan in DEFAULT.plans():
        whole = [run for run in plan.runs if plan.arms[run.arm].whole]
        for budget in {plan.arms[run.arm].steps for run in whole}:
            jobs = plan.jobs(FOLDER, [run for run in whole if plan.arms[run.arm].steps == budget])
            taken = {steps_of(job.settings) for job in jobs}
            assert len(taken) == 1
            assert taken.pop() == pytest.approx(budget, rel=0.2)  # rounds of batches


def test_whole_steps_are_near_those_that_were_asked_for():
    assert {steps_of(SEEN.training(run, FOLDER)) for run in SEEN.runs_of("joint")} == {4_096_000}
    assert {steps_of(HIDDEN.training(run, FOLDER)) for run in HIDDEN.runs_of("joint")} == {
        7_987_200
    }


def test_main_protocols_have_all_seeds_and_the_others_a_few():
    counts = {name: arm.seeds for name, arm in HIDDEN.arms.items()}
    assert {name: counts[name] for name in MAIN} == dict.fromkeys(MAIN, 10)
    assert {count for name, count in counts.items() if name not in MAIN} == {3}
    assert {arm.seeds for arm in PARALLEL.arms.values()} == {3}


def test_every_run_has_a_folder_and_a_seed_that_arms_share():
    jobs = {job.folder: job.settings for job in HIDDEN.jobs(FOLDER, HIDDEN.runs)}
    assert len(jobs) == len(HIDDEN.runs)
    for arm in HIDDEN.arms:
        seeds = [jobs[run.folder(FOLDER)].seed for run in HIDDEN.runs_of(arm)]
        assert seeds == [part_seed(0, k) for k in range(len(seeds))]
    tried = [job.settings.seed for job in HIDDEN.jobs(FOLDER, HIDDEN.tuning_runs)]
    assert set(tried).isdisjoint(settings.seed for settings in jobs.values())
    assert len(set(tried)) == 1


def test_a_task_sets_what_the_vehicle_ai_sees():
    run = PlannedRun("hidden", "simultaneous", 0)
    hidden = HIDDEN.training(run, FOLDER)
    assert not hidden.ai_sees_attention
    assert hidden.rnn_hidden_dim == 32
    assert hidden.sequential
    assert not PARALLEL.training(replace(run, task="hidden-parallel"), FOLDER).sequential
    assert SEEN.training(replace(run, task="seen"), FOLDER).ai_sees_attention
    assert HIDDEN.team().ai_sees_attention is False
    (graded,) = replace(DEFAULT, tasks=("graded",)).plans()
    assert graded.team().alert_strengths == (0.25, 0.5, 0.75, 1.0)
    (fatigue,) = replace(DEFAULT, tasks=("fatigue",)).plans()
    assert fatigue.team().fatigue is not None


def test_tasks_leave_out_what_they_do_not_allow():
    assert "simultaneous-moves" in SEEN.protocols
    assert "simultaneous-moves" not in HIDDEN.protocols  # that is the task hidden-parallel
    assert PARALLEL.protocols == ("two-stage", "simultaneous")
    assert set(HIDDEN.protocols) == set(compared()) - {"simultaneous-moves"}


def test_anchored_runs_wait_for_the_driver_that_they_are_anchored_to():
    first, second = HIDDEN.waves()
    assert {run.arm for run in second} >= {"anchored-0.003", "anchored-0.3", ROBUST}
    assert not any("anchored" in run.arm for run in first)
    for run in second:
        if run.arm.startswith("anchored"):
            settings = HIDDEN.training(run, FOLDER)
            assert settings.anchor == str(FOLDER / f"hidden/two-stage-run{run.number}")
            assert f"anchored-{settings.anchor_kl:g}" == run.arm


def test_waves_begin_with_the_first_seeds():
    for wave in HIDDEN.waves():
        numbers = [run.number for run in wave]
        assert numbers == sorted(numbers)


def test_partners_fill_one_seat():
    driver = HIDDEN.training(PlannedRun("hidden", NO_TRAITS, 1), FOLDER)
    assert driver.condition == "hidden"
    assert [phase.seat for phase in driver.phases()] == ["driver"]
    robust = HIDDEN.training(PlannedRun("hidden", ROBUST, 1), FOLDER)
    names = [f"out/hidden/{name}-run1" for name in (*MAIN, NO_TRAITS)]
    assert robust.driver_policy == "mixture:" + ",".join([*names, RULE])
    assert [phase.seat for phase in robust.phases()] == ["vehicle_ai"]


def test_shares_are_tried_where_seats_learn_one_after_the_other():
    arms = HIDDEN.tuning_arms.values()
    assert {arm.protocol for arm in arms} == {"two-stage", "alternating", "fine-tune"}
    assert Counter(arm.driver_share for arm in arms) == {0.125: 3, 0.25: 3, 0.5: 3, 0.75: 3}
    assert {arm.steps for arm in arms} == {4_000_000}
    assert replace(DEFAULT, driver_shares=(0.6,)).plans()[1].tuning_arms == {}


def test_a_share_that_was_chosen_is_taken():
    chosen = {"two-stage": 0.75}
    plan = replace(HIDDEN, shares=chosen)
    budgets = {
        name: plan.budget(plan.arms[name]) for name in ("two-stage", "alternating", TWO_STAGE)
    }
    assert budgets["two-stage"].driver_steps / budgets["two-stage"].steps == pytest.approx(
        0.75, abs=0.02
    )
    assert budgets["alternating"].driver_steps / budgets["alternating"].steps == pytest.approx(
        0.5, abs=0.02
    )
    settings = plan.training(PlannedRun("hidden", TWO_STAGE, 0), FOLDER)
    assert settings.driver_steps == budgets["two-stage"].driver_steps


def test_gradient_steps_count_both_learners():
    runs = {name: HIDDEN.training(PlannedRun("hidden", name, 0), FOLDER) for name in MAIN}
    batches, each = 7_987_200 // 51_200, 3 * 8
    assert gradient_steps(runs["two-stage"]) == batches * each
    assert gradient_steps(runs["joint"]) == batches * each
    assert gradient_steps(runs["simultaneous"]) == 2 * batches * each


def test_all_play_with_all_of_the_same_and_of_the_next_seed():
    pairs = all_pairs(HIDDEN)
    assert len(pairs) == len(set(pairs))

    def pair(driver: str, hmi: str) -> Pair:
        return Pair("hidden", f"hidden/{driver}", f"hidden/{hmi}")

    there = {
        pair("joint-run3", "joint-run3"),
        pair("joint-run3", "joint-run4"),
        pair("joint-run9", "two-stage-run0"),
        pair("alternating-run2", "joint-run0"),  # as many as both have
        pair("no-traits-run0", "simultaneous-run0"),
        pair("simultaneous-run1", "robust-run1"),
        pair("two-stage-run1", "anchored-0.3-run1"),
        pair("anchored-0.3-run1", "two-stage-run1"),
        Pair("hidden", RULE, "hidden/robust-run0"),
    }
    not_there = {
        pair("joint-run3", "joint-run5"),
        pair("alternating-run2", "joint-run3"),
        pair("robust-run0", "robust-run0"),
        pair("joint-run1", "anchored-0.3-run1"),
        pair("no-traits-run0", "two-stage-budget-1000000-run0"),
    }
    assert there <= set(pairs)
    assert not_there.isdisjoint(pairs)


def test_standing_runs_are_of_the_first_task():
    standing = [run for run in SEEN.runs if run.standing]
    assert {run.arm for run in standing} == set(SEEN.protocols)
    assert not SEEN.training(standing[0], FOLDER).end_at_crash
    assert not any(run.standing for run in HIDDEN.runs)
    assert not any(r.standing for r in replace(DEFAULT, crash_check=False).plans()[0].runs)


def test_the_reward_is_the_same_for_all_that_learn_together():
    plan = SEEN
    rewards = {name: plan.training(PlannedRun("seen", name, 0), FOLDER) for name in plan.protocols}
    assert rewards["joint"].reward == rewards["simultaneous"].reward == "team"
    assert plan.driver_terms("two-stage") == DRIVING_TERMS
    assert plan.driver_terms("two-stage-team") == TERMS
    individual = replace(DEFAULT, reward="individual").plans()[0]
    assert individual.training(PlannedRun("seen", "joint", 0), FOLDER).reward == "individual"
    assert "two-stage-team" not in individual.arms


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tasks": ()}, "at least one of seen"),
        ({"tasks": ("sen",)}, "unknown task 'sen'; did you mean seen"),
        ({"tasks": ("seen", "seen")}, "tasks names 'seen' twice"),
        ({"protocols": ()}, "at least one of two-stage"),
        ({"protocols": "joint"}, "a tuple of at least one"),
        ({"protocols": ("fast",)}, "unknown protocol 'fast'; known: two-stage"),
        ({"protocols": ("joint", "joint")}, "'joint' twice"),
        ({"steps": 0}, "steps lies in 1 to"),
        ({"budgets": (0,)}, "budgets"),
        ({"budgets": (10, 10)}, "budgets names a value twice"),
        ({"rounds": 0}, "rounds lies in 1 to"),
        ({"seeds": 0}, "seeds lies in 1 to"),
        ({"few_seeds": 0}, "few_seeds lies in 1 to"),
        ({"episodes": 0}, "episodes lies in 1 to"),
        ({"cross_episodes": 0}, "cross_episodes lies in 1 to"),
        ({"snapshots": 0}, "snapshots lies in 1 to"),
        ({"num_teams": 0}, "teams lies in 1 to"),
        ({"num_teams": 4}, "cannot split 4 teams into"),
        ({"driver_shares": ()}, "at least one share"),
        ({"driver_shares": (0.0,)}, r"driver_shares.* lies in \(0, 1\)"),
        ({"driver_shares": (float("nan"),)}, r"driver_shares.* lies in \(0, 1\)"),
        ({"anchor_kls": (-1.0,)}, "anchor_kls"),
        ({"anchor_kls": (0.1, 0.1)}, "anchor_kls names a value twice"),
        ({"anchor_kls": (0.1, 0.10000001)}, "anchor_kls names a value twice, to six digits"),
        ({"anchor_kls": (0.0, 0.1)}, "anchor_kls are weights above 0"),
        ({"reward": "driving"}, "reward is one of default, team, individual"),
        ({"seed": -1}, "a seed lies in"),
        (
            {"steps": 1_000},
            "1,000 steps of two-stage in task seen are fewer than .* 2 rounds, 6,400",
        ),
        ({"steps": 12_000}, "6,000 steps of two-stage-share-0.5 .* or give one of driver_shares"),
        ({"rounds": 1_000_000}, "are fewer than a batch for each seat in 1000000 rounds"),
        ({"drivers": ()}, "at least one name"),
        ({"drivers": "homer"}, "a tuple of names"),
        ({"drivers": ("bob",)}, "unknown driver 'bob'"),
        ({"drivers": ("homer", "Homer")}, "'homer' twice"),
        ({"drivers": ("homer", "bob:0.8,0.2,1,9")}, "homer and bob have the same traits"),
        ({"protocols": ("joint",)}, "task hidden-parallel allows none of joint; leave it out"),
        ({"tasks": ("hidden",), "protocols": ("simultaneous-moves",)}, "task hidden allows none"),
        ({"duration": 0.33}, "whole number of steps"),
        ({"vehicles": (3, 1)}, "vehicles"),
    ],
)
def test_impossible_settings_are_refused(change: dict, message: str) -> None:
    with pytest.raises((ValueError, TypeError), match=message):
        replace(SMALL, **change)


def test_budgets_differ_by_whole_steps_and_not_by_six_digits():
    assert replace(SMALL, budgets=(100_000_000, 100_000_001)).budgets[1] == 100_000_001


def test_a_small_comparison_keeps_the_seed_and_nothing_else_that_it_sets():
    small = coarse(replace(ProtocolComparison(), seed=7))
    assert small.seed == 7
    assert small.tasks == ("hidden",)
    with pytest.raises(ValueError, match="--quick sets steps itself"):
        coarse(replace(ProtocolComparison(), steps=5_000_000))
    assert set(QUICK) <= set(vars(small))


def test_every_task_makes_teams_and_runs():
    for name, entry in TASKS.items():
        (plan,) = replace(SMALL, tasks=(name,)).plans()
        assert entry.value.name == name
        assert plan.jobs(FOLDER, plan.runs)


def test_too_few_episodes_say_how_many_are_enough():
    with pytest.raises(ValueError, match=r"cross_episodes = 1, of which \w+ has none") as refused:
        replace(SMALL, cross_episodes=1)
    enough = int(re.search(r"with (\d+) each driver", str(refused.value))[1])
    assert replace(SMALL, cross_episodes=enough).cross_episodes == enough
