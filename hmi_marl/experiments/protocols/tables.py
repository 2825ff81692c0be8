"""Tables of a comparison."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from hmi_marl.envs.rewards import DRIVING_TERMS
from hmi_marl.experiments import criteria
from hmi_marl.experiments.protocols.arms import TEAM_ALONE, TWO_STAGE
from hmi_marl.experiments.protocols.costs import Cost, costs_of
from hmi_marl.experiments.protocols.cross_play import (
    Dependence,
    cell_of,
    dependence_of,
    drivers_of,
    hmis_of,
)
from hmi_marl.experiments.protocols.driving_costs import DrivingCost, driving_costs
from hmi_marl.experiments.protocols.equal_gradients import AtEqualGradients
from hmi_marl.experiments.protocols.findings import Compared, SweepPoint, sweep
from hmi_marl.experiments.protocols.gaming import Gaming, gaming_of
from hmi_marl.experiments.protocols.pairs import baselines
from hmi_marl.experiments.protocols.playing import shared_episodes
from hmi_marl.experiments.protocols.results import (
    Comparison,
    TaskResults,
    attention,
    bits,
    divergence,
    given_up,
    hiding,
    optimum,
    revealing,
    shortfall,
    signalling_arms,
)
from hmi_marl.experiments.signalling import SITUATIONS
from hmi_marl.reporting.blocks import Table
from hmi_marl.reporting.statistics import number


def summary_table(results: TaskResults) -> Table:
    """Show the protocols and known policies, each with the largest budget."""
    metrics = {
        "team return": ("team_return", "z.1f"),
        "attention return": ("attention_return", "z.1f"),
        "driving return": ("driving_return", "z.1f"),
        "alerts/min": ("alerts_per_minute", "z.1f"),
        "steps": ("length", "z.1f"),
    }
    groups = {arm.name: results.own(arm.name) for arm in results.main_arms()}
    rows = []
    for label, pairs in (groups | baselines(results.plan)).items():
        shown = [results.over_runs(pairs, name).shown(form) for name, form in metrics.values()]
        crashes = results.crash_rate(pairs).percent()
        score = results.score(pairs).shown(".3f")
        rows.append([label, f"{len(pairs)}", score, *shown, crashes])
    note = (
        f"Likeliest actions, {results.plan.settings.episodes} episodes, the same for all; every "
        "driver counts the same. score: attention return, 0 without alerts and 1 for the optimum "
        "that sees attention, both exact and over as many steps; interquartile mean over runs and "
        "drivers, with the bootstrap interval over runs, which covers less than 95 % with fewer "
        "than five of them, and the luck of the episodes, which are the same for all runs. Other "
        "brackets: Student's t interval over runs (95 %). Crashes: all episodes together, Wilson's "
        "interval."
    )
    unscored = set(results.plan.settings.driver_names) - set(results.scored_drivers)
    if unscored:
        note += f" Without a score, since alerts gain nothing: {', '.join(sorted(unscored))}."
    head = ["driver and HMI", "runs", "score", *metrics, "crashes [%]"]
    sources = [results.place("arms"), results.place("baselines")]
    return Table(f"{results.plan.name}: results", head, rows, note, sources)


def cost_table(results: TaskResults, workers: int) -> Table:
    """Show what each arm's runs cost."""
    columns: dict[str, Callable[[Cost], str]] = {
        "arm": lambda row: row.arm,
        "environment steps": lambda row: f"{row.steps:,}",
        "gradient steps": lambda row: f"{row.gradient_steps:,}",
        "seconds of a run": lambda row: row.seconds.shown(),
        "steps/s": lambda row: f"{row.steps_per_second:,.0f}",
        "driver alone": lambda row: f"{row.driver_alone:.2f}",
    }
    note = (
        f"Seconds: training alone, {workers} at a time. Gradient steps count both learners where "
        "two learn at once. driver alone: share of the steps in which only the driver learns."
    )
    title, sources = f"{results.plan.name}: costs", [results.place("costs")]
    return Table.of(title, costs_of(results), columns, note, sources)


def tuning_table(comparison: Comparison) -> Table:
    """Show the shares of the driver's stage that were tried."""
    rows = [
        [task, arm, f"{value:.1f}"]
        for task, tried in comparison.tried.items()
        for arm, value in tried.items()
    ]
    note = (
        "Half of the steps, one run each with a seed of its own; the share with the highest team "
        "return is taken."
    )
    head = ["task", "protocol and share", "team return"]
    sources = ["/driver_shares_tried"]
    return Table("Shares of the driver's stage that were tried", head, rows, note, sources)


def difference_table(changes: Sequence[Compared]) -> Table:
    """Show each protocol minus two-stage."""
    columns = _difference_columns(TWO_STAGE)
    note = (
        "Paired by seed, per episode, and corrected for the number of comparisons, those of "
        "protocols with all seeds by themselves: intervals by Bonferroni (all of them hold "
        "together with 95 %), p of the paired t test by Holm, which finds more: a row can differ "
        "although its interval holds 0. A few seeds show large differences only."
    )
    return Table.of(f"Protocols minus {TWO_STAGE}", changes, columns, note, ["/differences"])


def _difference_columns(reference: str) -> dict[str, Callable[[Compared], str]]:
    return {
        "task": lambda row: row.task,
        "protocol": lambda row: row.protocol,
        "metric": lambda row: row.metric.replace("_", " "),
        f"minus {reference}": lambda row: row.difference.estimate.shown("+z.1f"),
        "runs": lambda row: f"{row.difference.pairs}",
        "p": lambda row: number(row.difference.p, ".4f"),
        "differs": lambda row: {True: "yes", False: "no", None: "-"}[row.difference.differs],
    }


def same_reward_table(changes: Sequence[Compared]) -> Table:
    """Show protocols that learn together minus two-stage with the team's reward in both stages."""
    note = (
        "The same reward for all, that of the team. Above, two-stage's driver learns from driving, "
        "as by default. Paired by seed; intervals by Bonferroni and p by Holm, for all "
        f"{len(changes)}."
    )
    title = f"With the team's reward in every stage, minus {TEAM_ALONE}"
    columns = _difference_columns(TEAM_ALONE)
    return Table.of(title, changes, columns, note, ["/differences_with_the_same_reward"])


def equal_gradients_table(rows: Sequence[AtEqualGradients]) -> Table:
    """Show each protocol minus two-stage at equal gradient steps."""
    columns: dict[str, Callable[[AtEqualGradients], str]] = {
        "task": lambda row: row.task,
        "protocol": lambda row: row.protocol,
        "gradient steps": lambda row: f"{row.gradient_steps:,}",
        f"{TWO_STAGE}'s": lambda row: f"{row.two_stage_gradient_steps:,}",
        "environment steps": lambda row: f"{row.steps:,}",
        f"of {TWO_STAGE}": lambda row: f"{row.two_stage_steps:,}",
        f"minus {TWO_STAGE}": lambda row: row.difference.estimate.shown("+z.1f"),
        "runs": lambda row: f"{row.difference.pairs}",
        "p": lambda row: number(row.difference.p, ".4f"),
    }
    note = (
        "Attention return per episode, paired by seed; intervals by Bonferroni and p by Holm, for "
        f"all {len(rows)}. Budgets with about as many gradient steps; protocols that take as many "
        "as two-stage at equal environment steps are compared above."
    )
    title = f"At equal gradient steps, minus {TWO_STAGE}"
    return Table.of(title, rows, columns, note, ["/differences_at_equal_gradient_steps"])


def improvement_table(results: TaskResults) -> Table:
    """Show the probability that a run of each protocol scores more than one of two-stage."""
    rows = [[name, found.shown(".2f")] for name, found in results.improvements().items()]
    note = "Scores of two runs drawn at random, mean over drivers; bootstrap interval over runs."
    head = ["protocol", f"probability to score more than {TWO_STAGE}"]
    sources = [results.place("probability_of_improvement")]
    return Table(f"{results.plan.name}: probability of improvement", head, rows, note, sources)


def regret_table(results: TaskResults) -> Table:
    """Show what is missing to the optimum, and on whose side."""
    natural = results.own(TWO_STAGE) if TWO_STAGE in results.plan.protocols else []
    rows = []
    for arm in results.main_arms():
        pairs = results.own(arm.name)
        rows.append(
            [
                arm.name,
                results.mean_of(pairs, optimum).shown(),
                results.mean_of(pairs, attention).shown(),
                results.mean_of(pairs, hiding).shown() if results.plan.task.hidden else "-",
                results.against_exact(pairs, shortfall).shown(),
                given_up(results, arm.name).shown("+z.1f") if natural else "-",
            ]
        )
    note = (
        "Per episode, mean over drivers. optimum: exact, sees attention, over as many steps. "
        "hiding: optimum minus the Bayes filter that knows the driver's traits and how often its "
        "actions reveal d (exact if steps reveal it independently). HMI: that filter (with "
        "attention seen, the optimum) minus what the HMI earns; its interval is over runs and over "
        "episodes, which are the same for all runs. driver: driving return of the "
        "two-stage pair of the same seed minus this one's, what the driver gives up in driving."
    )
    head = ["arm", "optimum", "attention return", "hiding", "HMI", "driver"]
    return Table(f"{results.plan.name}: regret by cause", head, rows, note, [results.place("arms")])


def driving_table(results: TaskResults) -> Table:
    """Show what drivers give up in driving, by term, and how much more they crash."""
    columns: dict[str, Callable[[DrivingCost], str]] = {
        "arm": lambda row: row.arm,
        "driving": lambda row: row.driving.shown("+z.1f"),
    }
    for term in DRIVING_TERMS:
        columns[term.removesuffix("_reward").replace("_", " ")] = lambda row, term=term: (  # type: ignore[misc]
            row.by_term[term].shown("+z.1f")
        )
    columns["more crashes [%]"] = lambda row: row.crash_rate.percent("+z.1f")
    note = (
        f"Return per episode that the driver gives up: that of the {TWO_STAGE} pair of the same "
        "seed minus its own, mean over drivers; below 0 it earns more. driving: all terms. more "
        f"crashes: its crash rate minus {TWO_STAGE}'s. Brackets: Student's t interval over runs "
        "(95 % each)."
    )
    title, sources = f"{results.plan.name}: cost in driving", [results.place("driving_costs")]
    return Table.of(title, driving_costs(results), columns, note, sources)


def signal_table(results: TaskResults) -> Table:
    """Show how often drivers reveal d, and how much the HMI learns by it."""
    names = results.plan.settings.driver_names
    rows = []
    for arm in results.main_arms():
        pairs = results.own(arm.name)
        by_driver = results.by_driver(pairs, revealing).mean(axis=0)
        rows.append(
            [
                arm.name,
                results.mean_of(pairs, revealing).percent(),
                results.mean_of(pairs, bits).shown(".3f"),
                results.mean_of(pairs, divergence).shown(".3f"),
                *(f"{100 * share:.0f}" for share in by_driver),
            ]
        )
    note = (
        "revealing: steps in which a^H differs from the last applied action, so that the car shows "
        "whether the driver is distracted. bits: information about d_t in a^H_t and v_t beyond all "
        "before, exact. divergence: KL(driver || two-stage driver of the same seed), nats per step."
    )
    head = ["arm", "revealing [%]", "bits per step", "divergence"]
    head += [f"{name} [%]" for name in names]
    return Table(f"{results.plan.name}: signals", head, rows, note, [results.place("arms")])


def situation_table(results: TaskResults) -> Table:
    """Show where drivers reveal d: in two-stage and in simultaneous learning."""
    shares = {arm: results.revealing_by_situation(arm) for arm in signalling_arms(results)}
    rows = [
        [group, label, *(_percent(found[group][label]) for found in shares.values())]
        for group, labels in SITUATIONS.items()
        for label in labels
    ]
    head = ["situation", "", *(f"{name} [%]" for name in shares)]
    note = "Share of the steps in that situation in which a^H reveals d; all runs and drivers."
    sources = [results.place("revealing_by_situation")]
    return Table(f"{results.plan.name}: signals by situation", head, rows, note, sources)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def cross_table(results: TaskResults) -> Table:
    """Show the attention return of every arm's drivers with every arm's HMIs."""
    hmis = hmis_of(results)
    rows = []
    for driver in drivers_of(results):
        cells = [cell_of(results, driver, hmi) for hmi in hmis]
        rows.append(
            [driver, *(f"{c.same_seed.shown('z.0f')}\n{c.next_seed.shown('z.0f')}" for c in cells)]
        )
    note = (
        f"Attention return per episode, by the same {shared_episodes(results.plan)} episodes; "
        "above: runs of the same seed, below: the driver's run with the HMI of the next seed. "
        "Intervals over runs."
    )
    head = ["driver of", *(f"HMI of {name}" for name in hmis)]
    sources = [results.place("cross_play")]
    return Table(f"{results.plan.name}: every driver with every HMI", head, rows, note, sources)


def dependence_table(results: TaskResults) -> Table:
    """Show how much partners depend on each other."""
    rows = dependence_of(results)
    names = [row.arm for row in rows]
    columns: dict[str, Callable[[Dependence], str]] = {"arm": lambda row: row.arm}
    for name in names:
        columns[f"with {name}"] = lambda row, name=name: (  # type: ignore[misc]
            row.on_seed if name == row.arm else row.on_protocol[name]
        ).shown("+z.1f")
    note = (
        "Own minus swapped pairs, ½ [M(a,a) + M(b,b)] - ½ [M(a,b) + M(b,a)], with M the attention "
        "return of a's driver with b's HMI: 0 if partners could be exchanged freely. On the "
        "diagonal: with the next run of the same arm."
    )
    title = f"{results.plan.name}: how much partners depend on each other"
    return Table.of(title, rows, columns, note, [results.place("dependence")])


def sweep_table(results: TaskResults) -> Table:
    """Show the sweep over λ."""
    columns: dict[str, Callable[[SweepPoint], str]] = {
        "λ": lambda row: "∞ (two-stage)" if math.isinf(row.weight) else f"{row.weight:g}",
        "divergence": lambda row: row.divergence.shown(".3f"),
        "attention return": lambda row: row.attention_return.shown(),
        "team return": lambda row: row.team_return.shown(),
        "score": lambda row: row.score.shown(".3f"),
    }
    note = (
        "Simultaneous learning with λ KL(driver || two-stage driver of the same seed) in the "
        "driver's loss; 0 is the free driver. divergence: nats per step, on the driver's own way."
    )
    title = f"{results.plan.name}: drivers held close to the natural one"
    return Table.of(title, sweep(results), columns, note, [results.place("sweep")])


def budget_table(results: TaskResults) -> Table:
    """Show returns at every budget."""
    rows = []
    budgeted = [arm for arm in results.whole_arms() if arm.anchor_kl is None]
    for arm in sorted(budgeted, key=lambda arm: (arm.protocol, arm.steps)):
        pairs = results.own(arm.name)
        training = results.cost(arm.name)
        rows.append(
            [
                arm.protocol if arm.name.startswith(f"{arm.protocol}-budget") else arm.name,
                f"{training.steps:,}",
                f"{training.gradient_steps:,}",
                f"{len(pairs)}",
                results.over_runs(pairs, "attention_return").shown(),
                results.over_runs(pairs, "team_return").shown(),
            ]
        )
    head = [
        "protocol",
        "environment steps",
        "gradient steps",
        "runs",
        "attention return",
        "team return",
    ]
    note = "Each budget is a training of its own, with its own schedules, not a snapshot."
    sources = [results.place("costs"), results.place("arms")]
    return Table(f"{results.plan.name}: returns by budget", head, rows, note, sources)


def gaming_table(results: TaskResults) -> Table:
    """Show crash rates with and without an end at the crash, and whether crashing pays."""
    note = (
        "Crashes: all episodes together; a crash ends the episode, in training and now. In team "
        "returns of all drivers each counts the same. Trained standing: one run trained "
        "with end_at_crash=False, where a crashed car stands until the time is over (whether it "
        "crashes does not depend on what would follow, so the rate is that of both settings); "
        "return, stands: its team return in that setting. worth of a step: mean reward of a step "
        "that the driver learns from, without the collision term; where it is negative, ending "
        "early pays. GAMED: crashes more often than two-stage's (intervals more than "
        f"{criteria.MORE_CRASHES:g} apart) and a step's worth is negative; crashes more: only the "
        "former; fine: neither. The two-stage driver learns from driving alone and is the "
        "reference, a mild one if it has not learned long enough."
    )
    columns: dict[str, Callable[[Gaming], str]] = {
        "protocol": lambda row: row.protocol,
        "driver": lambda row: row.driver,
        "crashes [%]": lambda row: row.crash_rate.percent(),
        "two-stage's [%]": lambda row: row.two_stage_crash_rate.percent(),
        "team return": lambda row: number(row.team_return, "z.1f"),
        "per step": lambda row: number(row.team_return_per_step, "z.2f"),
        "worth of a step": lambda row: number(row.worth_of_a_step, "+z.2f"),
        "trained standing [%]": lambda row: row.crash_rate_if_trained_standing.percent(),
        "return, stands": lambda row: number(row.team_return_standing, "z.1f"),
        "finding": lambda row: row.finding,
    }
    title = f"{results.plan.name}: does crashing pay?"
    return Table.of(title, gaming_of(results), columns, note, [results.place("gaming")])
