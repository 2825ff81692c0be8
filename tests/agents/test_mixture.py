import numpy as np
import pytest
import torch
from trait_models import save_driver

from hmi_marl.agents import make_driver_policy, make_hmi, save_policy
from hmi_marl.agents.driving import RandomDriver, RuleBasedDriver
from hmi_marl.agents.hmis import AlertWhenDistracted, BeliefAlert, RandomAlert
from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.agents.learned.policy import LearnedPolicy, make_card
from hmi_marl.agents.memory import Memoryless
from hmi_marl.agents.mixture import Mixture
from hmi_marl.agents.partners import make_vec
from hmi_marl.agents.rollout import Observer, begin, play
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.seats import parts_read

CONFIG = TeamConfig(driver=["bart", "homer"], duration=3.0)
HIDDEN = TeamConfig(driver="bart", ai_sees_attention=False, duration=3.0)
SEEDS = np.arange(24, dtype=np.uint64)


def recurrent(seat=DRIVER, seed=0, sequential=True, reads_intent=True):
    """A policy with a memory, whose actions are drawn and depend on all that it saw."""
    card = make_card(
        seat,
        CONFIG,
        NetworkConfig((6,), rnn_hidden_dim=4),
        True,
        by_intent=not reads_intent,
        sequential=sequential,
    )
    rng = np.random.default_rng(seed)
    weights = {n: rng.standard_normal(shape).astype("f4") for n, shape in card.shapes.items()}
    return LearnedPolicy(card, weights, CONFIG, greedy=False)


def drivers():
    """Policies that remember, that draw, and that do neither."""
    return [recurrent(), RandomDriver(), RuleBasedDriver(CONFIG)]


def hmis():
    return [recurrent(VEHICLE_AI), RandomAlert(0.4), BeliefAlert("bart", CONFIG)]


class Recorder(Observer):
    """Keeps what the HMI sees, a^H included, and the rewards of both, in each step."""

    def __init__(self):
        self.rows = []

    def seen(self, teaming, observations):
        self.observed = observations.copy()

    def after(self, teaming, result):
        rewards = [result.rewards[seat][:, None] for seat in (DRIVER, VEHICLE_AI)]
        self.rows.append(np.concatenate([self.observed, *rewards], axis=1))


def episodes(driver, hmi, seeds=SEEDS):
    """Everything that happened in the episodes of these seeds, shape (N, steps, D)."""
    recorder = Recorder()
    teaming = begin(CONFIG, driver, hmi, seeds, "batched")
    play(teaming, driver, hmi, [recorder], steps=CONFIG.horizon)
    return np.stack(recorder.rows, axis=1)


@pytest.mark.parametrize("seat", [DRIVER, VEHICLE_AI])
def test_each_episode_is_that_of_the_policy_that_plays_in_it(seat):
    def played(policy):
        seats = (policy, RandomAlert(0.4)) if seat == DRIVER else (recurrent(seed=5), policy)
        return episodes(*seats)

    make = drivers if seat == DRIVER else hmis
    mixture = Mixture(make(), seat)
    mixed = played(mixture)
    alone = np.stack([played(policy) for policy in make()])
    playing = mixture.playing
    assert set(playing) == {0, 1, 2}
    for team, who in enumerate(playing):
        np.testing.assert_array_equal(mixed[team], alone[who, team])
        others = [k for k in range(3) if k != who]
        assert all((mixed[team] != alone[k, team]).any() for k in others)


def test_who_plays_and_how_does_not_depend_on_the_batch():
    mixture = Mixture(drivers(), DRIVER)
    whole = episodes(mixture, RandomAlert(0.4))
    playing = mixture.playing
    for teams in ([3], [7, 2, 19], np.arange(24)[::-1]):
        part = Mixture(drivers(), DRIVER)
        found = episodes(part, RandomAlert(0.4), SEEDS[teams])
        np.testing.assert_array_equal(part.playing, playing[teams])
        np.testing.assert_array_equal(found, whole[teams])


def test_teams_that_begin_again_leave_the_others_as_they_were():
    rng = np.random.default_rng(0)
    observations = rng.random((12, 6, 52), dtype=np.float32)
    later = SEEDS[:6] + np.uint64(100)
    which = np.array([False, True, False, True, True, False])

    def acted(rows, seeds, first, again=None):
        mixture, actions = Mixture(drivers(), DRIVER), []
        mixture.reset(seeds[rows])
        for step in range(first, 12):
            if step == again:
                mixture.reset(later[rows], which[rows])
            actions.append(mixture.act(observations[step, rows]))
        return np.stack(actions), mixture.playing

    every = np.arange(6)
    actions, playing = acted(every, SEEDS[:6], 0, again=5)
    unbroken, before = acted(every, SEEDS[:6], 0)
    np.testing.assert_array_equal(playing[~which], before[~which])
    assert (playing[which] != before[which]).any()
    np.testing.assert_array_equal(actions[:, ~which], unbroken[:, ~which])
    np.testing.assert_array_equal(actions[:5], unbroken[:5])
    fresh, now = acted(every[which], later, 5)
    np.testing.assert_array_equal(playing[which], now)
    np.testing.assert_array_equal(actions[5:, which], fresh)


def test_the_series_of_a_team_as_a_partner_does_not_depend_on_the_other_teams():
    def series(teams):
        partner = Mixture(drivers(), DRIVER)
        env = make_vec(teams, "vehicle_ai", partner, threads=1, **vars(CONFIG))
        rows, played, ends = [], [], 0
        for _ in range(3 * CONFIG.horizon):
            played.append(partner.playing[:3])
            _, rewards, dones, _ = env.step(torch.zeros((teams, 1), dtype=torch.int64))
            seen = env.get_observations()["vehicle_ai"][:3].numpy()
            rows.append(np.concatenate([seen, rewards[:3, None].numpy()], axis=1))
            ends += int(dones[:3].sum())
        assert ends >= 9
        return np.stack(rows), np.stack(played)

    few, many = series(3), series(9)
    np.testing.assert_array_equal(few[0], many[0])
    np.testing.assert_array_equal(few[1], many[1])
    assert {len(set(team)) for team in few[1].T} & {2, 3}  # another one after an end


@pytest.mark.parametrize("count", [2, 3, 5])
def test_all_play_equally_often_and_independently_of_the_other_seat(count):
    seeds = np.arange(1000, dtype=np.uint64)
    mixtures = [
        Mixture([RandomAlert(0.0) for _ in range(count)], seat) for seat in (DRIVER, VEHICLE_AI)
    ]
    for mixture in mixtures:
        mixture.reset(seeds)
        shares = np.bincount(mixture.playing, minlength=count)
        spread = np.sqrt(1000 * (1 - 1 / count) / count)
        assert (abs(shares - 1000 / count) < 3 * spread).all()
    together = (mixtures[0].playing == mixtures[1].playing).sum()
    assert abs(together - 1000 / count) < 3 * np.sqrt(1000 * (1 - 1 / count) / count)


def test_it_reads_what_its_policies_read():
    class ReadsAll(Memoryless):
        def act(self, observations):
            return np.zeros(len(observations), np.int64)

    class ReadsMore(RuleBasedDriver):
        def act(self, observations):
            return super().act(observations)

    rule = ("lidar", "speed", "target_speed")
    assert Mixture([RandomDriver(), RuleBasedDriver(CONFIG)], DRIVER).reads == rule
    assert set(Mixture(drivers(), DRIVER).reads) == set(recurrent().reads) | set(rule)
    for other in (ReadsAll(), ReadsMore(CONFIG)):
        mixture = Mixture([RandomDriver(), other], DRIVER)
        assert parts_read(mixture) is mixture.reads is None


def test_what_makes_no_mixture_is_refused():
    with pytest.raises(ValueError, match="takes two policies or more, but got 1"):
        Mixture([RandomDriver()], DRIVER)
    same = RandomDriver()
    with pytest.raises(ValueError, match="separate objects"):
        Mixture([same, same], DRIVER)
    with pytest.raises(ValueError, match="no other mixture"):
        Mixture([RandomDriver(), Mixture(drivers(), DRIVER)], DRIVER)
    with pytest.raises(TypeError, match="a Policy object"):
        Mixture([RandomDriver, RandomDriver()], DRIVER)
    mixture = Mixture(drivers(), DRIVER)
    with pytest.raises(RuntimeError, match=r"call reset\(seeds\) for 2 teams first"):
        mixture.act(np.zeros((2, 52), np.float32))
    mixture.reset(SEEDS)
    with pytest.raises(RuntimeError, match=r"call reset\(seeds\) for 2 teams first"):
        mixture.act(np.zeros((2, 52), np.float32))


def test_hmis_that_read_the_intent_see_it_all_at_the_same_time():
    late, early = recurrent(VEHICLE_AI, sequential=False), recurrent(VEHICLE_AI)
    never, seen = RandomAlert(0.0), AlertWhenDistracted(CONFIG)  # see no a^H, whenever it is
    with pytest.raises(
        ValueError, match="number 2 has learned with simultaneous moves and number 1 and 4 sees a"
    ):
        Mixture([early, late, never, BeliefAlert("bart", CONFIG)], VEHICLE_AI)
    assert not Mixture([never, late, seen], VEHICLE_AI).sequential
    assert Mixture([never, early, seen], VEHICLE_AI).sequential
    assert Mixture([never, seen], VEHICLE_AI).sequential
    drive = [recurrent(sequential=False), recurrent()]
    assert Mixture(drive, DRIVER).sequential  # drivers act first in any case


def test_mixtures_by_name(tmp_path):
    runs = [save_driver(tmp_path / name, k) for k, name in enumerate(("a", "b"))]
    mixture = make_driver_policy(f"Mixture:{runs[0]},Rule,{runs[1]}/driver.json,random", CONFIG)
    kinds = [LearnedPolicy, RuleBasedDriver, LearnedPolicy, RandomDriver]
    assert [type(policy) for policy in mixture.policies] == kinds
    weights = [mixture.policies[k].weights["layer0.weight"] for k in (0, 2)]
    assert (weights[0] != weights[1]).any()
    hmi = make_hmi("mixture:never,belief:homer:0.3,random:0.1", HIDDEN)
    assert [type(policy) for policy in hmi.policies] == [RandomAlert, BeliefAlert, RandomAlert]
    assert (hmi.policies[1].model.name, hmi.policies[1]._rule.revealing) == ("homer", 0.3)
    twice = make_driver_policy("mixture:random,random", CONFIG)
    assert twice.policies[0] is not twice.policies[1]


def test_moves_reach_the_hmis_of_a_mixture(tmp_path):
    for name, sequential in (("early", True), ("late", False)):
        policy = recurrent(VEHICLE_AI, sequential=sequential)
        save_policy(tmp_path / name, policy.card, policy.weights)
    early, late = tmp_path / "early", tmp_path / "late"
    with pytest.raises(ValueError, match=r"'mixture:.*late': HMIs in a mixture move all after"):
        make_hmi(f"mixture:{early},{late}", CONFIG)
    with pytest.raises(ValueError, match=r"early' in 'mixture:.*train with --no-sequential"):
        make_hmi(f"mixture:{early},{late}", CONFIG, sequential=False)
    for sequential in (True, False):
        both = make_hmi("mixture:belief:bart,belief:homer", CONFIG, sequential)
        assert [hmi._sequential for hmi in both.policies] == [sequential] * 2


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mixture", r"^mixture:NAME,NAME,... takes two policies or more, .* not 'mixture:'$"),
        ("mixture:rule", r"takes two policies or more, separated by .* not 'mixture:rule'$"),
        ("mixture:rule,", r"separated by single commas, not 'mixture:rule,'$"),
        ("mixture:,rule", r"separated by single commas"),
        ("mixture:rule,hal", r"^'hal' in 'mixture:rule,hal': unknown driver policy 'hal'; known"),
        ("mixture:rule,ruel", r"did you mean rule\?.* \(commas separate the policies of a mixture"),
        ("mixture:rule,mixture:random,rule", r"^'mixture:random' in 'mixture:.*two policies"),
        ("mixtur:rule,random", r"unknown driver policy .*known: rule, random, mixture"),
    ],
)
def test_a_bad_mixture_is_refused_by_its_name(name, message):
    with pytest.raises(ValueError, match=message):
        make_driver_policy(name, CONFIG)


def test_a_path_with_a_comma_is_told_to_be_out_of_reach(tmp_path):
    save_driver(tmp_path / "a,b")
    with pytest.raises(FileNotFoundError, match="no path or name in it can contain one") as error:
        make_driver_policy(f"mixture:rule,{tmp_path}/a,b", CONFIG)
    assert "\n" not in str(error.value)
    with pytest.raises(ValueError, match=r"'optimal:bob:0.5' in .* can contain one"):
        make_hmi("mixture:never,optimal:bob:0.5,0.4,1,3", CONFIG)
