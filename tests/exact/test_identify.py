import doctest
import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy, make_card, save_policy
from hmi_marl.demonstrations.dataset import Observed, Truth
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs import attention
from hmi_marl.envs.attention import Attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import DRIVERS, PAPER_DRIVERS, Driver, Traits
from hmi_marl.envs.teaming import Teaming
from hmi_marl.exact import identify as identifying
from hmi_marl.exact import oracle
from hmi_marl.exact.bayes_filter import BayesFilter, posterior
from hmi_marl.exact.identify import Identification, identify, marginal, perceived

FOUR = [DRIVERS[name] for name in PAPER_DRIVERS]


# The filter, against every hidden sequence.


def sequences(
    driver: Driver, window: int, policy: NDArray[np.float64], applied: list[int], alerts: list[int]
) -> tuple[float, float]:
    """p(v) and p(v, d_T = 1), by enumerating every d_0 ... d_T; policy[t] is π(a^H_t)."""
    traits, weight = Traits.of([driver]), np.zeros(2)
    for hidden in itertools.product((0, 1), repeat=len(applied)):
        probability, now = 1.0, Attention.initial(1)
        for t, d in enumerate(hidden):
            after = attention.step(now, np.array(alerts[t : t + 1]), traits, window, np.zeros(1))
            helped = driver.eta * int(after.accepted[0])
            was = now.distracted[0] == 1
            p = 1 - min(1, driver.alpha + helped) if was else max(0, driver.beta - helped)
            probability *= p if d else 1 - p
            if t > 0 and d:
                probability *= applied[t] == applied[t - 1]
            else:
                probability *= policy[t, applied[t]]
            now = replace(after, distracted=np.array([d]))
        weight[hidden[-1]] += probability
    return weight.sum(), weight[1]


unit = st.floats(0, 1)
candidates = st.builds(Driver, st.just("k"), unit, unit, unit, st.just(1.0))


class Window(NamedTuple):
    policies: NDArray[np.float64]
    """Shape (K, T, 5)."""
    applied: list[int]
    alerts: list[int]


@st.composite
def windows(draw: st.DrawFn, count: int) -> Window:
    steps = draw(st.integers(1, 7))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    policies = rng.dirichlet(np.full(5, draw(st.sampled_from([0.1, 1.0]))), (count, steps))
    if draw(st.booleans()):
        policies[policies < 0.1] = 0.0  # intents that never come
        policies /= policies.sum(axis=2, keepdims=True)
    applied = draw(st.lists(st.integers(0, 2), min_size=steps, max_size=steps))
    alerts = draw(st.lists(st.integers(0, 1), min_size=steps, max_size=steps))
    return Window(policies, applied, alerts)


def log(p: float) -> float:
    return float(np.log(p)) if p > 0 else -np.inf


@settings(max_examples=60)
@given(drivers=st.tuples(candidates, candidates), window=st.integers(1, 4), data=st.data())
def test_the_evidence_is_that_of_all_hidden_sequences_together(
    drivers: tuple[Driver, Driver], window: int, data: st.DataObject
) -> None:
    bayes, expected = BayesFilter(drivers, window, 1), np.zeros(2)
    for seen in data.draw(st.lists(windows(2), min_size=1, max_size=2)):
        bayes.begin()
        for t, (v, alert) in enumerate(zip(seen.applied, seen.alerts, strict=True)):
            bayes.update(seen.policies[:, t : t + 1], [v], [alert])
        found = [
            sequences(driver, window, policy, seen.applied, seen.alerts)
            for driver, policy in zip(drivers, seen.policies, strict=True)
        ]
        expected += [log(p) for p, _ in found]
        for k, (p, with_distracted) in enumerate(found):
            if p > 1e-200:
                assert bayes.distracted[0, k] == pytest.approx(with_distracted / p, abs=1e-9)
    # Products of so many small numbers are less than floats can hold; their logarithms are not.
    held = expected > -690
    np.testing.assert_allclose(bayes.log_evidence[0, held], expected[held], rtol=1e-9, atol=1e-9)
    assert (bayes.log_evidence[0, ~held] < -680).all()
    assert ((bayes.distracted >= 0) & (bayes.distracted <= 1 + 1e-12)).all()


@given(drivers=st.tuples(candidates, candidates), data=st.data())
def test_the_evidence_of_all_that_could_be_applied_sums_to_one(
    drivers: tuple[Driver, Driver], data: st.DataObject
) -> None:
    policies = np.random.default_rng(data.draw(st.integers(0, 999))).dirichlet(np.ones(5), (2, 3))
    every = np.array(list(itertools.product(range(5), repeat=3)))
    alerts = data.draw(st.lists(st.integers(0, 1), min_size=3, max_size=3))
    bayes = BayesFilter(drivers, 2, len(every))
    for t in range(3):
        chances = np.repeat(policies[:, t][:, None], len(every), axis=1)
        bayes.update(chances, every[:, t], np.full(len(every), alerts[t]))
    np.testing.assert_allclose(np.exp(bayes.log_evidence).sum(axis=0), 1.0)


def even(count: int, teams: int = 1) -> NDArray[np.float64]:
    return np.full((count, teams, 5), 0.2)


def test_two_steps_by_hand() -> None:
    # Bart: p(d_0) = 0.8 and v_0 shows nothing. Then, not alerted, p(d_1) = 0.8 * 0.8 + 0.2 * 0.8.
    # Homer is alerted first: p(d_0) = 0, and i stays 1, so p(d_1) = 0.
    bayes = BayesFilter(["bart", "homer"], 7, 1)
    bayes.update(even(2), [1], [1])
    assert np.exp(bayes.log_evidence[0]) == pytest.approx([0.2, 0.2])
    assert bayes.distracted[0] == pytest.approx([0.79, 0.0])
    chances = np.array([[[0.1, 0.5, 0.1, 0.2, 0.1]], [[0.0, 0.25, 0.25, 0.25, 0.25]]])
    bayes.update(chances, [1], [0])
    before = 0.79 * 0.79 + 0.21 * 0.79  # bart in effect of an alert: becomes 0.79, stays 0.79
    assert np.exp(bayes.log_evidence[0]) == pytest.approx([0.2 * (before + 0.21 * 0.5), 0.2 * 0.25])
    assert bayes.distracted[0] == pytest.approx([before / (before + 0.21 * 0.5), 0.0])
    odds = np.array([before + 0.105, 0.25])
    np.testing.assert_allclose(bayes.posterior()[0], odds / odds.sum())
    np.testing.assert_allclose(bayes.posterior([3, 1])[0], odds * [3, 1] / (odds @ [3, 1]))


def test_another_action_than_the_last_shows_that_the_driver_is_attentive() -> None:
    bayes = BayesFilter(["bart"], 7, 1)
    bayes.update(even(1), [1], [0])
    bayes.update(even(1), [3], [0])
    assert bayes.distracted[0, 0] == 0.0
    assert np.exp(bayes.log_evidence[0, 0]) == pytest.approx(0.2 * 0.2 * 0.2)


def test_evidence_stays_when_a_window_begins_and_all_else_begins_anew() -> None:
    bayes = BayesFilter(PAPER_DRIVERS, 7, 2)
    for v in (1, 1, 3):
        bayes.update(even(4, 2), [v, v], [1, 1])
    first = bayes.log_evidence.copy()
    bayes.begin(np.array([True, False]))
    np.testing.assert_array_equal(bayes.log_evidence, first)
    assert (bayes.distracted[0] == 0).all()
    for v in (1, 1, 3):
        bayes.update(even(4, 2), [v, v], [1, 1])
    np.testing.assert_allclose(bayes.log_evidence[0], 2 * first[0])
    assert (bayes.log_evidence[1] != 2 * first[1]).any()


def test_teams_that_take_no_step_are_left_as_they_are() -> None:
    bayes, alone = BayesFilter(PAPER_DRIVERS, 7, 2), BayesFilter(PAPER_DRIVERS, 7, 1)
    for v, active in ((1, True), (9, False), (1, True), (-1, False), (2, True)):
        bayes.update(even(4, 2), [v, 1], [0, 0], np.array([active, True]))
        if active:
            alone.update(even(4), [v], [0])
    np.testing.assert_array_equal(bayes.log_evidence[0], alone.log_evidence[0])
    np.testing.assert_array_equal(bayes.distracted[0], alone.distracted[0])


def test_a_candidate_who_cannot_have_done_it_is_out_for_good() -> None:
    bayes = BayesFilter(["lisa", "bart"], 7, 1)
    chances = even(2)
    chances[0, 0] = [1, 0, 0, 0, 0]
    bayes.update(chances, [2], [0])
    assert bayes.log_evidence[0, 0] == -np.inf
    bayes.begin()
    bayes.update(even(2), [2], [0])
    assert bayes.posterior().tolist() == [[0.0, 1.0]]
    with pytest.raises(ValueError, match="row 0 is impossible for every candidate"):
        bayes.posterior([1, 0])


def test_a_candidate_who_cannot_have_done_it_still_sees_what_is_plain() -> None:
    # k never intends 1 nor is ever distracted, but v stays 1, and then is 2.
    awake = Driver("awake", 0.0, 1.0, 0.0, 1.0)
    bayes = BayesFilter([awake, "bart"], 7, 1)
    chances = even(2)
    chances[0, 0] = [0.5, 0, 0.5, 0, 0]
    found = []
    for v in (1, 1, 2):
        bayes.update(chances, [v], [0])
        found.append(bayes.distracted[0, 0])
    assert found == [0.0, 1.0, 0.0]
    assert bayes.log_evidence[0, 0] == -np.inf


def test_a_step_returns_what_it_adds_to_the_evidence() -> None:
    bayes, before = BayesFilter(["bart", "homer"], 7, 2), np.zeros((2, 2))
    for v, alert, active in ((1, 1, True), (1, 0, False), (3, 0, True)):
        gain = bayes.update(even(2, 2), [v, 1], [alert, 0], np.array([active, True]))
        np.testing.assert_array_equal(bayes.log_evidence, before + gain)
        assert gain.all(axis=1).tolist() == [active, True]
        before = bayes.log_evidence.copy()
    assert (bayes.accepted.tolist(), bayes.counter.tolist()) == ([1, 0], [1, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"intent_probabilities": even(4)}, r"shape \(K, N, 5\) = \(4, 2, 5\), not \(4, 1, 5\)"),
        ({"intent_probabilities": even(4, 2) * np.nan}, r"an intent lies in \[0, 1\]"),
        ({"intent_probabilities": even(4, 2) * 6}, r"an intent lies in \[0, 1\]"),
        ({"applied": [1, 5]}, "applied actions lie in 0 to 4, but got 5"),
        ({"applied": [1, -1]}, "applied actions lie in 0 to 4, but got -1"),
        ({"applied": [1]}, r"applied actions are integers of shape \(2,\)"),
        ({"applied": [1.0, 1.0]}, "applied actions are integers"),
        ({"alerts": [0, 2]}, "alerts lie in 0 to 1, but got 2"),
        ({"active": np.array([1, 0])}, r"bools of shape \(2,\), but got int64"),
        ({"active": np.array([True])}, r"bools of shape \(2,\)"),
    ],
)
def test_a_step_that_cannot_be_is_refused_and_changes_nothing(
    change: dict[str, Any], message: str
) -> None:
    bayes = BayesFilter(PAPER_DRIVERS, 7, 2)
    step: dict[str, Any] = {
        "intent_probabilities": even(4, 2),
        "applied": [1, 1],
        "alerts": [0, 0],
    }
    with pytest.raises(ValueError, match=message):
        bayes.update(**(step | change))
    assert not bayes.log_evidence.any()
    assert not bayes.distracted.any()


def test_a_filter_needs_candidates_and_teams() -> None:
    with pytest.raises(ValueError, match="at least one candidate"):
        BayesFilter([], 7, 1)
    with pytest.raises(ValueError, match="count lies in"):
        BayesFilter(PAPER_DRIVERS, 7, 0)
    with pytest.raises(ValueError, match="unknown driver 'moe'"):
        BayesFilter(["moe"], 7, 1)
    with pytest.raises(TypeError, match="a list of drivers, not 'bart'"):
        BayesFilter("bart", 7, 1)
    with pytest.raises(ValueError, match="alert_window lies in 1 to"):
        BayesFilter(PAPER_DRIVERS, 0, 1)


# From evidence to who it was.


def test_posterior_by_hand() -> None:
    log_evidence = np.log([[0.1, 0.3], [0.2, 0.2]])
    np.testing.assert_allclose(posterior(log_evidence), [[0.25, 0.75], [0.5, 0.5]])
    np.testing.assert_allclose(posterior(log_evidence, [3, 1]), [[0.5, 0.5], [0.75, 0.25]])
    np.testing.assert_allclose(posterior(log_evidence, [[3, 1], [0, 2]]), [[0.5, 0.5], [0, 1]])
    np.testing.assert_allclose(posterior(log_evidence - 5000.0), [[0.25, 0.75], [0.5, 0.5]])


@pytest.mark.parametrize(
    ("prior", "message"),
    [
        ([1, 1, 1], r"a prior has shape \(2,\) or \(1, 2\), not \(3,\)"),
        ([1, -1], "finite numbers >= 0"),
        ([1, np.nan], "finite numbers >= 0"),
        ([1, np.inf], "finite numbers >= 0"),
        ([0, 0], "not all of them 0"),
    ],
)
def test_what_is_no_prior_is_refused(prior: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        posterior(np.zeros((1, 2)), prior)


def test_pooled_evidence_is_the_sum_and_labels_share_out_the_posterior() -> None:
    rng = np.random.default_rng(0)
    found = Identification(tuple(FOUR), rng.normal(size=(6, 4)))
    pools = found.pooled([[0, 2], [5, 1], [3, 3]])
    e = found.log_evidence
    np.testing.assert_allclose(pools.log_evidence, [e[0] + e[2], e[5] + e[1], 2 * e[3]])
    p = pools.posterior()
    np.testing.assert_allclose(p.sum(axis=1), 1.0)
    receptive = marginal(p, [driver.eta >= 0.5 for driver in FOUR])
    assert list(receptive) == [False, True]
    np.testing.assert_allclose(receptive[False], p[:, 0] + p[:, 2])
    np.testing.assert_allclose(receptive[True], p[:, 1] + p[:, 3])


def test_pools_and_labels_that_do_not_fit_are_refused() -> None:
    found = Identification(tuple(FOUR), np.zeros((6, 4)))
    for groups in ([0, 1], [[0.0, 1.0]]):
        with pytest.raises(ValueError, match=r"integers of shape \(P, n\)"):
            found.pooled(groups)
    with pytest.raises(IndexError):
        found.pooled([[6]])
    with pytest.raises(ValueError, match="4 candidates, but 2 labels"):
        marginal(found.posterior(), ["a", "b"])


def test_windows_that_exclude_each_others_drivers_are_of_no_driver() -> None:
    found = Identification(tuple(FOUR[:2]), np.array([[0.0, -np.inf], [-np.inf, 0.0]]))
    assert found.posterior().tolist() == [[1, 0], [0, 1]]
    with pytest.raises(ValueError, match="row 0 is impossible for every candidate"):
        found.pooled([[0, 1]]).posterior()


# Whole windows, played again.


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A driver that reads the traits, with weights as they come."""
    folder = tmp_path_factory.mktemp("trained")
    card = make_card("driver", TeamConfig(), NetworkConfig((8,)), knows_traits=True)
    rng = np.random.default_rng(0)
    weights = {
        name: 0.4 * rng.standard_normal(shape).astype(np.float32)
        for name, shape in card.shapes.items()
    }
    save_policy(folder, card, weights)
    return folder


class Data(NamedTuple):
    """Collected windows, their drivers, and the policy."""

    config: TeamConfig
    policy: LearnedPolicy
    observed: Observed
    truth: Truth

    @property
    def arrays(self) -> tuple[Any, ...]:
        one = self.observed
        return one.seeds, one.actions, one.alerts, one.length

    def identify(self, drivers: Sequence[str | Driver] = PAPER_DRIVERS) -> Identification:
        return identify(self.config, self.policy, drivers, *self.arrays)


def collected(trained: Path, **settings: Any) -> Data:
    small = {"steps": 40, "duration": 2.0, "vehicles": (1, 8), "driver_policy": str(trained)}
    played = CollectSettings(**{**small, **settings})
    config = played.team(PAPER_DRIVERS)
    (data,) = collect(replace(played, num_teams=10_000))
    assert data.truth is not None
    policy = load_policy(trained, "driver", config, greedy=played.greedy)
    return Data(config, policy, data.observed, data.truth)


@pytest.mark.parametrize("end_at_crash", [False, True])
@pytest.mark.parametrize("observe_traits", [True, False])
def test_what_is_perceived_is_what_the_driver_saw(end_at_crash: bool, observe_traits: bool) -> None:
    config = TeamConfig(
        driver=PAPER_DRIVERS,
        duration=4.0,
        end_at_crash=end_at_crash,
        observe_traits=observe_traits,
        scene=replace(TeamConfig().scene, vehicles=(20, 20), after=None),
    )
    count, steps = 40, config.horizon
    seeds, rng = np.arange(count, dtype=np.uint64), np.random.default_rng(0)
    live = Teaming(config, count, "batched")
    live.reset(seeds)
    who = [FOUR.index(driver) for driver in map(driver_of, live.traits.as_array())]
    saw = []
    actions, alerts = np.full((count, steps), -1), np.zeros((count, steps), np.int64)
    for t in range(steps):
        on = ~live.over
        saw.append(live.observe("driver"))
        live.intend(rng.integers(0, 5, count))
        live.step(rng.integers(0, 2, count))
        actions[on, t], alerts[on, t] = live.applied[on], live.alerted[on]
    assert set(who) == {0, 1, 2, 3}
    assert 5 < live.ego.crashed.sum() < count
    replayed = perceived(config, FOUR, seeds, actions, alerts, live.steps)
    for t, seen in enumerate(replayed):
        assert seen.shape == (4, count, live.layouts["driver"].size)
        on = t < live.steps
        np.testing.assert_array_equal(seen[who, np.arange(count)][on], saw[t][on])
    assert t == steps - 1


def driver_of(traits: NDArray[np.float64]) -> Driver:
    return next(driver for driver in FOUR if driver.traits == tuple(traits))


def test_a_window_is_what_the_filter_makes_of_the_policy_step_by_step(trained: Path) -> None:
    data = collected(trained, drivers=("homer", "lisa"))
    found = data.identify()
    seeds, actions, alerts, _ = data.arrays
    for k, driver in enumerate(FOUR):
        attentive = replace(driver, name="attentive", beta=0.0, alpha=1.0, eta=0.0)
        teams = Teaming(replace(data.config, driver=attentive), len(seeds), "batched")
        teams.reset(seeds)
        data.policy.reset(seeds)
        bayes = BayesFilter([driver], 7, len(seeds))
        for t in range(10):
            teams.traits = Traits.of([driver] * len(seeds))  # as they are shown
            seen = teams.observe("driver")
            teams.traits = Traits.of([attentive] * len(seeds))
            bayes.update(data.policy.probabilities(seen)[None], actions[:, t], alerts[:, t])
            teams.intend(actions[:, t])
            teams.step(alerts[:, t])
        np.testing.assert_allclose(found.log_evidence[:, k], bayes.log_evidence[:, 0])


def test_the_posterior_is_calibrated_and_sharper_with_more_windows(trained: Path) -> None:
    data = collected(trained, steps=200 * 10)
    found = data.identify()
    who = data.observed.driver
    right = found.posterior().argmax(axis=1) == who
    confidence = found.posterior().max(axis=1)
    # If the data are as they are taken to be, these means are 0; four deviations.
    assert abs((right - confidence).mean()) < 4 * (right - confidence).std() / np.sqrt(len(who))
    for k in range(4):
        excess = (who == k) - found.posterior()[:, k]
        assert abs(excess.mean()) < 4 * excess.std() / np.sqrt(len(who))
    assert right.mean() > 0.5  # of four
    pools = np.concatenate([np.flatnonzero(who == k).reshape(-1, 5) for k in range(4)])
    together = found.pooled(pools).posterior().argmax(axis=1) == who[pools[:, 0]]
    assert together.mean() > right.mean() + 0.1


def test_p_of_d_is_calibrated_if_the_driver_is_known(trained: Path) -> None:
    data = collected(trained, drivers=("bart",), steps=200 * 40, duration=8.0)
    bayes = BayesFilter(["bart"], 7, len(data.observed))
    replayed = identifying.replay_intents(data.config, data.policy, [FOUR[2]], *data.arrays)
    excess = np.zeros(len(data.observed))
    for t, intents in enumerate(replayed):
        bayes.update(intents, data.observed.actions[:, t], data.observed.alerts[:, t])
        excess += data.truth.distracted[:, t] - bayes.distracted[:, 0]
    assert abs(excess.mean()) < 4 * excess.std() / np.sqrt(len(excess))


def test_candidates_in_another_order_are_columns_in_another_order(trained: Path) -> None:
    data = collected(trained)
    order = [2, 0, 3, 1]
    other = data.identify([PAPER_DRIVERS[k] for k in order])
    assert other.drivers == tuple(FOUR[k] for k in order)
    expected = data.identify().log_evidence[:, order]
    np.testing.assert_allclose(other.log_evidence, expected, rtol=1e-12)


@pytest.mark.parametrize("rows", [1, 12, 100])
def test_the_evidence_does_not_depend_on_how_many_windows_are_played_at_once(
    trained: Path, monkeypatch: pytest.MonkeyPatch, rows: int
) -> None:
    data = collected(trained)
    expected = data.identify().log_evidence
    monkeypatch.setattr(identifying, "_ROWS", rows)
    np.testing.assert_allclose(data.identify().log_evidence, expected, rtol=1e-12)


def test_steps_after_the_end_are_no_evidence(trained: Path) -> None:
    data = collected(trained)
    seeds, actions, alerts, length = data.arrays
    shorter = np.where(np.arange(len(length)) % 2, 6, length)
    found = identify(data.config, data.policy, FOUR, seeds, actions, alerts, shorter)
    cut = np.arange(actions.shape[1]) >= shorter[:, None]
    without = np.where(cut, -1, actions), np.where(cut, 7, alerts)
    same = identify(data.config, data.policy, FOUR, seeds, *without, shorter)
    np.testing.assert_array_equal(found.log_evidence, same.log_evidence)
    whole = data.identify().log_evidence
    np.testing.assert_allclose(found.log_evidence[::2], whole[::2], rtol=1e-12)
    assert (found.log_evidence[1::2] > whole[1::2]).any()


def test_no_windows_are_no_evidence(trained: Path) -> None:
    data = collected(trained)
    none = (values[:0] for values in data.arrays)
    found = identify(data.config, data.policy, PAPER_DRIVERS, *none)
    assert found.log_evidence.shape == found.posterior().shape == (0, 4)


def test_windows_that_end_at_the_crash(trained: Path) -> None:
    crashing = {"vehicles": (20, 20), "duration": 4.0, "steps": 400}
    standing, ending = (collected(trained, **crashing, end_at_crash=e) for e in (False, True))
    assert standing.observed.crashed.any()
    cut = replace_length(standing, standing.observed.driven)
    np.testing.assert_allclose(
        ending.identify().log_evidence, cut.identify().log_evidence, rtol=1e-12
    )
    with pytest.raises(ValueError, match=r"goes on after step \d+, .*\(see end_at_crash\)"):
        standing._replace(config=ending.config).identify()


def replace_length(data: Data, length: NDArray[np.int64]) -> Data:
    one = data.observed
    on = np.arange(one.actions.shape[1]) < length[:, None]
    observed = replace(
        one,
        length=length,
        actions=np.where(on, one.actions, -1),
        alerts=one.alerts * on,
        states=one.states * on[..., None],
    )
    return data._replace(observed=observed)


def test_a_greedy_driver_intends_the_likeliest_for_sure(trained: Path) -> None:
    data = collected(trained, greedy=True, steps=200, drivers=PAPER_DRIVERS)
    found = data.identify()
    who = data.observed.driver
    rows = np.arange(len(who))
    assert (found.log_evidence[rows, who] > -np.inf).all()
    assert (found.log_evidence == -np.inf).any()
    assert (found.posterior()[rows, who] > 0).all()
    drawn = data._replace(policy=load_policy(trained, "driver", data.config, greedy=False))
    assert (drawn.identify().log_evidence > -np.inf).all()


def test_data_that_cannot_be_of_this_policy_are_refused(trained: Path) -> None:
    data = collected(trained, steps=100)
    data.policy.greedy = True
    with pytest.raises(ValueError, match=r"impossible for every candidate: the data are not"):
        data.identify().posterior()


@pytest.mark.parametrize("make", [RandomDriver, lambda: RuleBasedDriver(TeamConfig()), lambda: int])
def test_a_policy_without_probabilities_is_refused(trained: Path, make: Any) -> None:
    data = collected(trained)
    with pytest.raises(TypeError, match="policy must give its probabilities: pass an object"):
        data._replace(policy=make()).identify()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": None}, r"seeds has shape \(16,\), not \(\)"),
        ({"actions": np.zeros(16, np.int64)}, r"shape \(E, T\) with at most 10 steps"),
        ({"actions": np.zeros((16, 11), np.int64)}, "with at most 10 steps"),
        ({"actions": np.full((16, 10), 5)}, "applied actions lie in 0 to 4, but got 5"),
        ({"actions": np.full((16, 10), -1)}, "applied actions lie in 0 to 4, but got -1"),
        ({"alerts": np.full((16, 10), 2)}, "alerts lie in 0 to 1, but got 2"),
        ({"alerts": np.zeros((16, 9), np.int64)}, r"alerts has shape \(16, 10\)"),
        ({"length": np.full(16, 11)}, "length lies in 0 to 10, but got 11"),
        ({"length": np.full(15, 10)}, r"length has shape \(16,\), not \(15,\)"),
        ({"drivers": []}, "at least one candidate"),
    ],
)
def test_data_that_do_not_fit_are_refused(
    trained: Path, change: dict[str, Any], message: str
) -> None:
    data = collected(trained)
    names = ("seeds", "actions", "alerts", "length")
    given_data = dict(zip(names, data.arrays, strict=True)) | {"drivers": PAPER_DRIVERS}
    with pytest.raises(ValueError, match=message):
        identify(data.config, data.policy, **(given_data | change))


def test_seeds_that_are_no_integers_are_refused(trained: Path) -> None:
    data = collected(trained)
    _, *rest = data.arrays
    with pytest.raises(TypeError, match="seeds are integers"):
        identify(data.config, data.policy, PAPER_DRIVERS, np.zeros(16), *rest)


def test_the_doctest_of_the_module() -> None:
    results = doctest.testmod(identifying, extraglobs={"np": np})
    assert results.attempted > 0
    assert results.failed == 0


def test_it_is_an_oracle() -> None:
    assert oracle.identify is identify
