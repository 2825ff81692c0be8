"""Posteriors over traits against brute force, grids, other filters and simulated populations."""

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, load_policy, make_card, save_policy
from hmi_marl.demonstrations.dataset import Demonstrations
from hmi_marl.demonstrations.recording import CollectSettings, collect
from hmi_marl.envs import attention
from hmi_marl.envs.config import TeamConfig
from hmi_marl.envs.drivers import Choice, Driver, TraitDistributions, Uniform
from hmi_marl.exact import oracle
from hmi_marl.exact.bayes_filter import BayesFilter
from hmi_marl.exact.identify import identify, replay_intents
from hmi_marl.exact.importance import Sampling
from hmi_marl.exact.trait_likelihood import TraitLikelihood, Windows
from hmi_marl.exact.trait_posterior import TraitPosterior, trait_posterior

FEW = Sampling(groups=32, effective=20)
CASES = [(seen, known) for seen in (False, True) for known in (False, True)]


class Data:
    """Windows of a small population, with their policy."""

    def __init__(self, policy: LearnedPolicy, config: TeamConfig, data: Demonstrations) -> None:
        self.policy, self.config, self.observed = policy, config, data.observed
        assert data.truth is not None
        self.truth = data.truth

    @property
    def arrays(self) -> tuple[Any, ...]:
        one = self.observed
        return one.seeds, one.actions, one.alerts, one.length

    def take(self, which: Any) -> "Data":
        return Data(self.policy, self.config, Demonstrations(self.observed, self.truth).take(which))

    def posterior(self, seen: bool, known: bool, **more: Any) -> tuple[TraitPosterior, ...]:
        policy = self.policy if known else None
        intended = self.truth.intended if seen else None
        options = {"person": self.observed.driver, "sampling": FEW} | more
        return trait_posterior(self.config, policy, *self.arrays, intended=intended, **options)

    def likelihood(self, seen: bool, known: bool, person: NDArray[np.int64]) -> TraitLikelihood:
        intended = self.truth.intended if seen else None
        windows = Windows.checked(self.config, *self.arrays, intended, person)
        return TraitLikelihood(self.config, self.policy if known else None, windows)


def make_policy(folder: Path, size: float = 0.4, **network: Any) -> Path:
    """A driver that reads the traits, with weights as they come."""
    card = make_card("driver", TeamConfig(), NetworkConfig(**network), knows_traits=True)
    rng = np.random.default_rng(0)
    weights = {
        name: size * rng.standard_normal(shape).astype(np.float32)
        for name, shape in card.shapes.items()
    }
    save_policy(folder, card, weights)
    return folder


def recorded(folder: Path, people: int, windows: int, duration: float, **more: Any) -> Data:
    settings = CollectSettings(
        drivers=(),
        population=people,
        windows=windows,
        duration=duration,
        vehicles=(1, 8),
        driver_policy=str(folder),
        num_teams=100_000,
        **more,
    )
    config = settings.team("lisa")
    (data,) = collect(settings)
    return Data(load_policy(folder, "driver", config, greedy=settings.greedy), config, data)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_policy(tmp_path_factory.mktemp("driver"), hidden_dims=(8, 6), activation="tanh")


@pytest.fixture(scope="module")
def data(folder: Path) -> Data:
    """Three people with two windows of ten steps each."""
    return recorded(folder, people=3, windows=2, duration=2.0)


def candidates(
    data: Data, rng: np.random.Generator, inflations: int, same: int
) -> NDArray[np.float64]:
    people = len(set(data.observed.driver.tolist()))
    traits = rng.random((people, inflations, same, 4))
    traits[..., 3] = 1 + 8 * traits[..., :1, 3]
    return traits


# The likelihood.


def probability(
    data: Data,
    row: int,
    driver: Driver,
    intents: NDArray[np.float64],
    seen: bool,
    known: bool,
    share: float,
) -> float:
    """p(window), by enumerating every d_0 ... d_{T-1}; ``intents`` are π(a^H_t), shape (T, 5)."""
    steps = int(data.observed.length[row])
    v, alerts = data.observed.actions[row], data.observed.alerts[row]
    a_h = data.truth.intended[row]
    helped, now_i, now_c = [], 0, 0
    for t in range(steps):
        i, c = attention.next_acceptance(now_i, now_c, alerts[t], data.config.alert_window)
        now_i, now_c = int(i), int(c)
        helped.append(now_i)
    total = 0.0
    for hidden in itertools.product((0, 1), repeat=steps):
        p, before = 1.0, 0
        for t, d in enumerate(hidden):
            becomes = max(0, driver.beta - driver.eta * helped[t])
            recovers = min(1, driver.alpha + driver.eta * helped[t])
            chance = (1 - recovers) if before else becomes
            p *= chance if d else 1 - chance
            applied_own = t == 0 or not d
            if seen:
                p *= v[t] == (a_h[t] if applied_own else v[t - 1])
                p *= intents[t, a_h[t]] if known else 1.0
            elif not applied_own:
                p *= v[t] == v[t - 1]
            elif known:
                p *= intents[t, v[t]]
            elif t > 0:
                p *= 1 - share if v[t] == v[t - 1] else share
            before = d
        total += p
    return total


@pytest.mark.parametrize(("seen", "known"), CASES)
def test_the_likelihood_is_that_of_all_hidden_sequences(
    data: Data, seen: bool, known: bool
) -> None:
    short = data.take([0, 1, 2])  # of two people
    short.observed.length[:] = [8, 5, 8]
    rng = np.random.default_rng(1)
    traits, share = candidates(short, rng, 2, 3), rng.random((2, 2, 3))
    traits[1] = candidates(short, rng, 2, 3)[0]
    person = short.observed.driver
    within = np.arange(short.observed.actions.shape[1]) < short.observed.length[:, None]
    short.observed.actions[~within] = -1
    found = short.likelihood(seen, known, person)(np.arange(2), traits, share)
    for p, m, j in itertools.product(range(2), range(2), range(3)):
        driver = Driver("k", *traits[p, m, j].tolist())
        played = replay_intents(short.config, short.policy, [driver], *short.arrays)
        intents = np.stack([step[0] for step in played])  # (T, E, 5)
        each = [
            probability(short, row, driver, intents[:, row], seen, known, share[p, m, j])
            for row in np.flatnonzero(person == p)
        ]
        expected = np.log(each).sum() if min(each) > 0 else -np.inf
        assert found[p, m, j] == pytest.approx(expected, rel=1e-10)
    assert np.isfinite(found).any()


def test_the_likelihood_is_that_of_the_other_filters(data: Data) -> None:
    traits = candidates(data, np.random.default_rng(2), 3, 2)
    found = data.likelihood(False, True, data.observed.driver)(np.arange(3), traits)
    chain = data.likelihood(True, False, data.observed.driver)(np.arange(3), traits)
    for person in range(3):
        rows = np.flatnonzero(data.observed.driver == person)
        drivers = [Driver("k", *each) for each in traits[person].reshape(-1, 4).tolist()]
        own = data.take(rows)
        expected = identify(own.config, own.policy, drivers, *own.arrays).log_evidence.sum(axis=0)
        np.testing.assert_allclose(found[person].ravel(), expected, rtol=1e-10)
        bayes = BayesFilter(drivers, own.config.alert_window, len(rows))
        for t in range(10):  # as ChainEvidence feeds it
            intended = np.eye(5)[own.truth.intended[:, t]]
            chances = np.broadcast_to(intended, (len(drivers), *intended.shape))
            bayes.update(chances, own.observed.actions[:, t], own.observed.alerts[:, t])
        np.testing.assert_allclose(chain[person].ravel(), bayes.log_evidence.sum(axis=0))


@pytest.mark.parametrize("network", [{"hidden_dims": (5,), "activation": "elu"}, {}])
@pytest.mark.parametrize("greedy", [False, True])
def test_the_compiled_network_is_the_policy(
    data: Data, tmp_path: Path, network: dict[str, Any], greedy: bool
) -> None:
    policy = load_policy(make_policy(tmp_path, **network), "driver", data.config, greedy)
    other = Data(policy, data.config, Demonstrations(data.observed, data.truth))
    traits = candidates(data, np.random.default_rng(3), 2, 2)
    compiled = other.likelihood(False, True, data.observed.driver)
    asked = other.likelihood(False, True, data.observed.driver)
    assert compiled._network is not None
    asked._network = None
    found, expected = (each(np.arange(3), traits) for each in (compiled, asked))
    np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_a_policy_that_remembers_is_asked(data: Data, tmp_path: Path) -> None:
    folder = make_policy(tmp_path, hidden_dims=(4,), rnn_hidden_dim=3)
    policy = load_policy(folder, "driver", data.config, greedy=False)
    assert policy.feedforward() is None
    other = Data(policy, data.config, Demonstrations(data.observed, data.truth))
    traits = candidates(data, np.random.default_rng(4), 2, 2)
    found = other.likelihood(False, True, data.observed.driver)(np.arange(3), traits)
    own = other.take([0, 1])
    drivers = [Driver("k", *each) for each in traits[0].reshape(-1, 4).tolist()]
    expected = identify(own.config, policy, drivers, *own.arrays).log_evidence.sum(axis=0)
    np.testing.assert_allclose(found[0].ravel(), expected, rtol=1e-10)


# The posterior.


def test_mean_quantiles_and_ranks_by_hand() -> None:
    points = np.array([[0.0, 0.2, 0.0, 1.0], [1.0, 0.2, 0.5, 3.0]])
    found = TraitPosterior(points, np.array([0.25, 0.75]), -1.0, 2.0, 1, True)
    np.testing.assert_allclose(found.mean(), [0.75, 0.2, 0.375, 2.5])
    variance = 0.25 * 0.75
    assert found.covariance()[0, 0] == pytest.approx(variance)
    assert found.covariance()[0, 3] == pytest.approx(2 * variance)
    # The middles of the weights are at 0.125 and 0.625.
    np.testing.assert_allclose(found.quantile(0.375), [0.5, 0.2, 0.25, 2.0])
    np.testing.assert_allclose(found.interval(0.25), found.quantile([0.375, 0.625]))
    assert found.quantile(np.zeros((2, 3))).shape == (2, 3, 4)
    np.testing.assert_allclose(found.rank([0.5, 0.2, 0.0, 9.0]), [0.25, 0.5, 0.125, 1.0])
    with pytest.raises(ValueError, match=r"lies in \[0, 1\]"):
        found.quantile(1.5)
    with pytest.raises(ValueError, match=r"level lies in \[0, 1\]"):
        found.interval(95)


@pytest.mark.parametrize(("seen", "known"), CASES)
def test_two_unknown_traits_have_the_posterior_of_a_fine_grid(
    data: Data, seen: bool, known: bool
) -> None:
    prior = TraitDistributions(
        alpha=Uniform(0.1, 0.9), eta=Choice((0.3,)), inflation=Choice((4.0,))
    )
    one = data.take([0, 1])
    sampling = Sampling(groups=1000, shared=1, effective=1500)
    (found,) = one.posterior(seen, known, prior=prior, sampling=sampling, person=None)
    middles = (np.arange(50) + 0.5) / 50
    beta, alpha, share = np.meshgrid(middles, 0.1 + 0.8 * middles, middles, indexing="ij")
    if seen or known:
        beta, alpha, share = beta[..., 0], alpha[..., 0], share[..., 0]
    traits = np.stack(
        [beta, alpha, np.full(beta.shape, 0.3), np.full(beta.shape, 4.0)], axis=-1
    ).reshape(1, 1, -1, 4)
    likelihood = one.likelihood(seen, known, np.zeros(2, np.int64))
    log_p = likelihood(np.zeros(1, np.int64), traits, share.reshape(1, 1, -1)).ravel()
    p = np.exp(log_p - log_p.max())
    mean = p @ traits[0, 0] / p.sum()
    spread = np.sqrt(p @ (traits[0, 0] - mean) ** 2 / p.sum())
    tolerance = 5 * spread / np.sqrt(found.effective_size) + 1e-9
    assert found.is_enough
    assert (np.abs(found.mean() - mean) < tolerance).all()
    assert np.sqrt(np.diag(found.covariance()))[:2] == pytest.approx(spread[:2], rel=0.15)
    assert found.log_evidence == pytest.approx(log_p.max() + np.log(p.mean()), abs=0.1)
    assert (found.revealing is None) == (seen or known)


def test_a_further_prior_counts(data: Data) -> None:
    def mostly_high(traits: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.log(20 * traits[:, 0] ** 19)  # E[β] = 20 / 21 in the prior

    one = data.take([0])
    (plain,) = one.posterior(True, False, person=None)
    (high,) = one.posterior(True, False, person=None, log_prior=mostly_high)
    weights = plain.weights * plain.points[:, 0] ** 19
    assert high.mean()[0] == pytest.approx(weights @ plain.points[:, 0] / weights.sum(), abs=0.03)
    with pytest.raises(ValueError, match="log_prior returns log densities"):
        one.posterior(True, False, person=None, log_prior=lambda traits: traits[:, 0] * np.nan)


@pytest.mark.parametrize("seen", [False, True])
def test_without_a_policy_inflation_stays_at_its_prior(data: Data, seen: bool) -> None:
    one = data.take([0, 1])
    (found,) = one.posterior(seen, False, person=None, sampling=Sampling(effective=1000))
    error = 8 / np.sqrt(12 * found.effective_size)
    assert found.mean()[3] == pytest.approx(5.0, abs=5 * error)
    assert np.sqrt(found.covariance()[3, 3]) == pytest.approx(8 / np.sqrt(12), rel=0.1)


@pytest.mark.parametrize(("seen", "known"), [(False, True), (False, False)])
def test_others_in_the_batch_change_no_bit(data: Data, seen: bool, known: bool) -> None:
    together = data.posterior(seen, known)
    alone = data.take(data.observed.driver == 1).posterior(seen, known, person=None)[0]
    again = data.posterior(seen, known)[1]
    for other in (alone, again):
        np.testing.assert_array_equal(together[1].points, other.points)
        np.testing.assert_array_equal(together[1].weights, other.weights)
        assert together[1].log_evidence == other.log_evidence
    elsewhere = data.posterior(seen, known, seed=1)[1]
    assert (elsewhere.points[:5] != together[1].points[:5]).any()
    assert elsewhere.log_evidence == pytest.approx(together[1].log_evidence, abs=1.0)


def test_threads_change_no_bit(data: Data, monkeypatch: pytest.MonkeyPatch) -> None:
    from hmi_marl.envs.worlds.batched import threads

    many = data.take(np.tile(np.arange(4), 8))  # enough to be shared
    first = many.posterior(False, True, person=np.zeros(32, np.int64))[0]
    monkeypatch.setattr(threads, "available", lambda: 1)
    second = many.posterior(False, True, person=np.zeros(32, np.int64))[0]
    np.testing.assert_array_equal(first.weights, second.weights)


def test_too_few_points_are_said(data: Data) -> None:
    few = Sampling(groups=16, rounds=1, most_rounds=2, effective=1000)
    found = data.posterior(False, True, sampling=few)
    assert not any(each.is_enough for each in found)
    assert {each.rounds for each in found} == {2}
    more = data.posterior(False, True, sampling=replace(few, most_rounds=8, effective=20))
    assert all(each.is_enough for each in more)
    assert max(each.rounds for each in more) > 2


def test_progress_counts_the_persons(data: Data) -> None:
    finished: list[int] = []
    data.posterior(True, False, progress=finished.append)
    assert sum(finished) == 3


def calibration(found: tuple[TraitPosterior, ...], true: NDArray[np.float64], columns: int) -> None:
    """Ranks of the truth are uniform: mean, spread and ends, each within four deviations."""
    ranks = np.array([each.rank(t) for each, t in zip(found, true, strict=True)])[:, :columns]
    count = len(ranks)
    assert (np.abs(ranks.mean(axis=0) - 0.5) < 4 * np.sqrt(1 / 12 / count)).all()
    for level in (0.5, 0.8, 0.95):
        covered = (np.abs(ranks - 0.5) < level / 2).mean(axis=0)
        # Points of finite number shift a rank a little, which widens the tolerance.
        assert (np.abs(covered - level) < 4 * np.sqrt(level * (1 - level) / count) + 0.02).all()


def test_posteriors_of_a_population_are_calibrated(folder: Path) -> None:
    people = recorded(folder, people=150, windows=2, duration=4.0)
    true = people.truth.traits[::2]
    calibration(people.posterior(True, False), true, 3)


@pytest.mark.long
@pytest.mark.slow
@pytest.mark.parametrize("seen", [False, True])
def test_posteriors_with_a_known_policy_are_calibrated(folder: Path, seen: bool) -> None:
    people = recorded(folder, people=300, windows=4, duration=10.0)
    found = people.posterior(seen, True, sampling=Sampling())
    assert np.mean([each.is_enough for each in found]) > 0.95
    calibration(found, people.truth.traits[::4], 4)


@pytest.mark.long
@pytest.mark.slow
def test_posteriors_with_hidden_intent_and_unknown_policy_are_calibrated_in_their_model() -> None:
    """Drivers whose a^H differs from v_{t-1} at random, with a share drawn from its prior."""
    count, steps, window = 400, 100, 7
    rng = np.random.default_rng(5)
    traits = TraitDistributions().draw(np.arange(count, dtype=np.uint64))
    share, alerts = rng.random(count), (rng.random((count, steps)) < 0.2).astype(np.int64)
    now, actions = attention.Attention.initial(count), np.zeros((count, steps), np.int64)
    for t in range(steps):
        now = attention.step(now, alerts[:, t], traits, window, rng.random(count))
        if t > 0:
            differs = (rng.random(count) < share) & (now.distracted == 0)
            actions[:, t] = (actions[:, t - 1] + differs * rng.integers(1, 5, count)) % 5
    length = np.full(count, steps)
    found = trait_posterior(
        TeamConfig(), None, None, actions, alerts, length, person=np.arange(count)
    )
    calibration(found, traits.as_array(), 3)
    covered = [each.weights @ (each.revealing < s) for each, s in zip(found, share, strict=True)]
    assert abs(np.mean(covered) - 0.5) < 4 * np.sqrt(1 / 12 / count)


# What is refused.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": None}, "a known policy needs the seeds"),
        ({"actions": np.full((6, 10), 5)}, "applied actions lie in 0 to 4, but got 5"),
        ({"actions": np.zeros((6, 10))}, "applied actions are integers"),
        ({"alerts": np.full((6, 10), 2)}, "alerts lie in 0 to 1, but got 2"),
        ({"length": np.full(6, 11)}, "length lies in 0 to 10, but got 11"),
        ({"intended": np.full((6, 10), 7)}, "intended actions lie in 0 to 4, but got 7"),
        ({"intended": np.zeros((6, 9), np.int64)}, "intended actions are integers of shape"),
        ({"person": np.zeros(5, np.int64)}, r"person holds a number for each window, integers"),
        ({"person": np.array([0, 0, 2, 2, 3, 3])}, "numbered 0, 1, 2, ... without a gap"),
        ({"person": np.array([-1, 0, 0, 0, 0, 0])}, "numbered 0, 1, 2, ... without a gap"),
    ],
)
def test_data_that_do_not_fit_are_refused(data: Data, change: dict[str, Any], message: str) -> None:
    names = ("seeds", "actions", "alerts", "length")
    given: dict[str, Any] = dict(zip(names, data.arrays, strict=True)) | change
    with pytest.raises(ValueError, match=message):
        trait_posterior(data.config, data.policy, **given)


def test_no_windows_are_refused(data: Data) -> None:
    none = (values[:0] for values in data.arrays)
    with pytest.raises(ValueError, match="at least one window"):
        trait_posterior(data.config, data.policy, *none)


@pytest.mark.parametrize("policy", [object(), LearnedPolicy])
def test_a_policy_without_probabilities_is_refused(data: Data, policy: Any) -> None:
    with pytest.raises(TypeError, match="must give its probabilities"):
        trait_posterior(data.config, policy, *data.arrays)


def test_actions_that_no_driver_can_have_applied_are_refused(data: Data) -> None:
    wrong = (data.truth.intended + 1) % 5
    with pytest.raises(ValueError, match="person 0 are impossible for all 64 candidates"):
        trait_posterior(data.config, None, *data.arrays, intended=wrong, sampling=FEW)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Sampling(groups=1), "Sampling: groups lies in 8 to"),
        (lambda: Sampling(shared=0), "Sampling: shared lies in 1 to"),
        (lambda: Sampling(effective=0), "Sampling: effective lies in 1 to"),
    ],
)
def test_impossible_sizes_are_refused(make: Callable[[], Sampling], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()


def test_it_is_an_oracle() -> None:
    assert oracle.trait_posterior is trait_posterior
