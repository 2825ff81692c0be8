from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evidence_models import HIDDEN, any_intents, save_trained, seeds, turns
from standing_world import standing_teams

from hmi_marl.agents import make_hmi
from hmi_marl.agents.adaptive import hmis
from hmi_marl.agents.adaptive.evidence_model import LearnedEvidence, load_evidence
from hmi_marl.agents.adaptive.hmis import (
    KINDS,
    TYPES,
    ChoosingHMI,
    ConditionedHMI,
    ExpectedValueHMI,
    Trained,
    make_adaptive,
)
from hmi_marl.agents.adaptive.trait_estimator import CHANGE_RATE
from hmi_marl.agents.learned.policy import read_policy, save_policy
from hmi_marl.envs.drivers import PAPER_DRIVERS, Driver, Traits
from hmi_marl.exact.evidence import ChainEvidence


@pytest.fixture
def trained(tmp_path):
    return save_trained(tmp_path)


@pytest.fixture
def shipped(trained, monkeypatch):
    """As if these came with the package."""
    monkeypatch.setattr(hmis, "Trained", lambda: trained)


@pytest.mark.usefixtures("shipped")
@pytest.mark.parametrize(
    ("name", "made", "evidence"),
    [
        ("adapt", ExpectedValueHMI, LearnedEvidence),
        ("adapt:expected", ExpectedValueHMI, LearnedEvidence),
        ("adapt:choosing", ChoosingHMI, LearnedEvidence),
        ("Adapt:Conditioned", ConditionedHMI, LearnedEvidence),
        ("adapt:bayes", ExpectedValueHMI, ChainEvidence),
        ("adapt:choosing:bayes", ChoosingHMI, ChainEvidence),
        ("adapt:conditioned:bayes", ConditionedHMI, ChainEvidence),
    ],
)
def test_by_name(name, made, evidence):
    hmi = make_hmi(name, HIDDEN)
    assert type(hmi) is made
    assert type(hmi.estimator.evidence) is evidence
    assert hmi.estimator.evidence.drivers == TYPES
    assert hmi.estimator.change_rate == CHANGE_RATE
    teams = standing_teams(3, driver=PAPER_DRIVERS, ai_sees_attention=False, duration=4.0)
    teams.reset(seeds(3))
    hmi.reset(seeds(3))
    alerts = [hmi.act(seen) for seen in turns(teams, any_intents(5, 3), hmi.act)]
    assert set(np.ravel(alerts)) <= {0, 1}


def test_the_exact_ones_need_nothing_learned_but_their_hmis(tmp_path):
    nothing = Trained(*(str(tmp_path / name) for name in ("evidence", "conditioned", "hidden-{}")))
    assert type(make_adaptive("expected", HIDDEN, True, trained=nothing)) is ExpectedValueHMI
    with pytest.raises(FileNotFoundError, match=r"no evidence model at .*evidence"):
        make_adaptive("expected", HIDDEN, trained=nothing)
    with pytest.raises(FileNotFoundError, match=r"no policy for the seat of vehicle_ai .*lisa"):
        make_adaptive("choosing", HIDDEN, True, trained=nothing)
    with pytest.raises(FileNotFoundError, match=r"no policy for .* at .*conditioned"):
        make_adaptive("conditioned", HIDDEN, True, trained=nothing)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("kind", KINDS)
def test_candidates_and_settings_reach_it(kind, exact, trained):
    candidates = [Driver("a", 0.3, 0.4, 0.1, 2.0), Driver("b", 0.6, 0.4, 0.1, 2.0)]
    hmi = make_adaptive(kind, HIDDEN, exact, candidates, trained, 0.2, 1.5, change_rate=0.01)
    estimator = hmi.estimator
    assert estimator.change_rate == 0.01
    among = TYPES if kind == "choosing" else tuple(candidates)
    assert estimator.evidence.drivers == among
    if kind == "expected":
        assert hmi.caution == 1.5
        assert hmi._default._rule.revealing == 0.2
    if kind == "conditioned":
        latents = load_evidence(trained.evidence).expected(Traits.of(candidates))
        np.testing.assert_array_equal(hmi.latents, latents)


def test_the_hmis_that_are_chosen_among_are_those_of_the_types(trained):
    hmi = make_adaptive("choosing", HIDDEN, True, trained=trained)
    for each, driver in zip(hmi.hmis, TYPES, strict=True):
        expected = trained.hidden_hmi(driver.name, HIDDEN)
        for name, values in expected.weights.items():
            np.testing.assert_array_equal(each.weights[name], values)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("adapt:guessing", "adaptive HMI 'guessing'; known: expected, choosing, conditioned"),
        ("adapt:guessing:bayes", "adaptive HMI 'guessing'; known: expected, choosing, conditioned"),
        ("adapt:expected:choosing", r"adapt\[:KIND\]\[:bayes\] names one kind, not 'expected:ch"),
    ],
)
def test_unknown_names_are_refused(name, message):
    with pytest.raises(ValueError, match=message):
        make_hmi(name, HIDDEN)


def test_who_acts_at_once_cannot_adapt():
    with pytest.raises(
        ValueError, match=r"adaptive HMI needs a\^H_t; use an env.* sequential moves"
    ):
        make_hmi("adapt:bayes", HIDDEN, sequential=False)


def test_a_folder_of_that_name_is_not_taken_for_a_run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "adapt").mkdir()
    (tmp_path / "adapt:bayes").mkdir()
    assert type(make_hmi("adapt:bayes", HIDDEN)) is ExpectedValueHMI


def test_an_hmi_whose_z_means_something_else_is_refused(trained):
    card, weights = read_policy(Path(trained.conditioned) / "vehicle_ai.json")
    own = load_evidence(trained.evidence).card.encoder
    for digest in (own, "of another model"):
        about = replace(card, training={"context_of": digest})
        save_policy(Path(trained.conditioned), about, weights)
        if digest == own:
            assert isinstance(make_adaptive("conditioned", HIDDEN, trained=trained), ConditionedHMI)
        else:
            with pytest.raises(ValueError, match="the z of another encoder"):
                make_adaptive("conditioned", HIDDEN, trained=trained)


def test_evidence_that_reads_another_encoder_is_refused(trained):
    other = replace(trained, traits="trained:traits-id")
    with pytest.raises(ValueError, match="reads the encoder of another trait model"):
        make_adaptive("expected", HIDDEN, trained=other)
    make_adaptive("conditioned", HIDDEN, True, trained=other)  # which reads no encoder


def test_hmis_to_choose_among_are_objects_of_their_own(trained):
    watching = make_adaptive("choosing", HIDDEN, True, trained=trained).estimator
    same = [make_hmi("belief:bart", HIDDEN)] * 4
    with pytest.raises(ValueError, match="needs a separate HMI object"):
        ChoosingHMI(watching, same)
