import numpy as np
import pytest

from hmi_marl.agents import (
    AlertWhenDistracted,
    BeliefAlert,
    OptimalAlert,
    RandomAlert,
    RandomDriver,
    RuleBasedDriver,
    make_driver_policy,
    make_hmi,
)
from hmi_marl.agents.catalogue import known_names
from hmi_marl.envs.config import DRIVER, VEHICLE_AI, TeamConfig
from hmi_marl.envs.drivers import Driver

SEEN = TeamConfig(driver="bart")
HIDDEN = TeamConfig(driver="bart", ai_sees_attention=False)


@pytest.mark.parametrize(
    ("name", "kind", "model"),
    [
        ("never", RandomAlert, None),
        ("NoHMI", RandomAlert, None),
        ("always", RandomAlert, None),
        ("random", RandomAlert, None),
        ("when-distracted", AlertWhenDistracted, None),
        ("optimal", OptimalAlert, "bart"),
        ("own", OptimalAlert, "bart"),
        ("optimal:Homer", OptimalAlert, "homer"),
        ("average", OptimalAlert, "average"),
        ("AvgHMI", OptimalAlert, "average"),
        ("belief", BeliefAlert, "bart"),
        ("belief:lisa", BeliefAlert, "lisa"),
    ],
)
def test_hmis_by_name(name, kind, model):
    hmi = make_hmi(name, SEEN)
    assert type(hmi) is kind
    if model:
        assert hmi.model.name == model


def test_rates_by_name():
    assert [make_hmi(name, SEEN).rate for name in ("never", "always", "random", "random:0.2")] == [
        0.0,
        1.0,
        0.5,
        0.2,
    ]


def test_the_belief_takes_the_share_of_steps_that_show_and_the_kind_of_turns():
    for name, model, revealing in (
        ("belief", "bart", 0.3),
        ("belief:lisa:0.1", "lisa", 0.1),
        ("Belief:Lisa:0", "lisa", 0.0),
        ("belief::0.5", "bart", 0.5),
    ):
        for sequential in (True, False):
            rule = make_hmi(name, HIDDEN, sequential)._rule
            assert (rule.driver.name, rule.revealing) == (model, revealing)
            # With simultaneous moves a^H is not known yet, so the rule is the same in both.
            assert np.array_equal(rule.advantage[:, 0], rule.advantage[:, 1]) != sequential


def test_driver_policies_by_name_whatever_the_case():
    assert type(make_driver_policy("Rule", SEEN)) is RuleBasedDriver
    assert type(make_driver_policy("RANDOM", SEEN)) is RandomDriver
    with pytest.raises(TypeError, match="name of the driver policy is a string"):
        make_driver_policy(None, SEEN)


@pytest.mark.parametrize("make", [lambda: RandomAlert(0.5), RandomDriver])
def test_a_policy_that_draws_asks_for_seeds_first(make):
    with pytest.raises(RuntimeError, match=r"call reset\(seeds\) first"):
        make().act(np.zeros((1, 3), np.float32))


def test_with_attention_hidden_the_optimum_is_on_the_belief():
    assert isinstance(make_hmi("own", HIDDEN), BeliefAlert)
    assert make_hmi("AvgHMI", HIDDEN).model.name == "average"


def test_every_listed_name_can_be_made():
    for make, seat, one in ((make_hmi, VEHICLE_AI, "never"), (make_driver_policy, DRIVER, "rule")):
        for name in known_names(seat):
            if "/" not in name and not name.startswith("trained:"):
                example = name.partition("[")[0].replace("NAME", one)
                make(example, SEEN if name[:5] != "adapt" else HIDDEN)
        with pytest.raises(FileNotFoundError, match="no policy for the seat"):
            make("runs/RUN", SEEN)  # stands for the folder of a run


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hal", "unknown HMI 'hal'; hmi-marl --help lists all$"),
        ("when-distraced", r"unknown HMI .*; did you mean when-distracted\? hmi-marl --help lists"),
        ("optmal:bart", r"unknown HMI 'optmal:bart'; did you mean optimal\?"),
        ("noHM", r"unknown HMI 'noHM'; did you mean nohmi"),
        ("optimal:ned", "unknown driver 'ned'"),
        ("random:often", r"takes a number in \[0, 1\], not 'often'"),
        ("random:1.5", "rate lies in"),
        ("never:3", "takes no argument"),
        ("belief:lisa:often", r"belief:DRIVER:SHARE takes a number in \[0, 1\], not 'often'"),
        ("belief:lisa:1.5", r"revealing lies in \[0, 1\]"),
        ("belief:lisa:nan", r"revealing lies in \[0, 1\]"),
        ("optimal:lisa:0.1", "name:beta,alpha,eta,inflation, not 'lisa:0.1'"),
    ],
)
def test_a_bad_hmi_is_refused(name, message):
    with pytest.raises(ValueError, match=message):
        make_hmi(name, SEEN)


def test_a_bad_driver_policy_is_refused():
    known = r"unknown driver policy 'hal'; known: rule, random, mixture \("
    with pytest.raises(ValueError, match=known):
        make_driver_policy("hal", SEEN)
    with pytest.raises(ValueError, match=r"policy 'ruel'; did you mean rule\? hmi-marl --help"):
        make_driver_policy("ruel", SEEN)


def test_the_own_optimum_of_a_population_is_refused():
    with pytest.raises(ValueError, match="name a driver model, for example optimal:average"):
        make_hmi("own", TeamConfig(driver=["lisa", "bart"]))
    with pytest.raises(TypeError, match="name of the HMI is a string"):
        make_hmi(3, SEEN)


def test_a_belief_can_be_over_a_driver_of_ones_own_with_a_share() -> None:
    config = TeamConfig(driver="homer", duration=2.0)
    for name, share in (("belief:bob:0.5,0.4,1,3", None), ("belief:bob:0.5,0.4,1,3:0.6", 0.6)):
        policy = make_hmi(name, config)
        assert isinstance(policy, BeliefAlert)
        assert policy.model == Driver("bob", 0.5, 0.4, 1.0, 3.0)
        if share is not None:
            assert policy._rule.revealing == share


def test_a_folder_of_a_known_name_is_not_taken_for_a_run(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    config = TeamConfig(driver="homer")
    for name in ("rule", "optimal", "average"):
        (tmp_path / name).mkdir()
    assert isinstance(make_driver_policy("rule", config), RuleBasedDriver)
    assert isinstance(make_hmi("average", config), OptimalAlert)
