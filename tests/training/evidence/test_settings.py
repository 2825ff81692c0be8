import pytest
from evidence_models import trait_model

from hmi_marl.agents.learned.network import NetworkConfig
from hmi_marl.training.evidence.settings import EvidenceSettings


def test_the_card_is_as_the_settings_say():
    settings = EvidenceSettings(latent=5, reads=("speed", "lane"), reader=NetworkConfig((8,)))
    card = settings.card(settings.team, trait_model())
    assert (card.latent, card.read_size, card.encoder) == (5, 5, trait_model().digest)
    assert card.reader == NetworkConfig((8,))
    assert (card.place, card.expected) == (settings.place, settings.expected)
    assert not settings.team.ai_sees_attention


@pytest.mark.parametrize(
    ("drives", "held_out", "learned"), [(100, 0.05, 95), (100, 0.5, 50), (20, 0.001, 18)]
)
def test_at_least_two_drives_are_held_out(drives, held_out, learned):
    assert EvidenceSettings(drives=drives, held_out=held_out, batch=4).learned == learned


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"drives": 0}, "drives lies in 1 to .*, but got 0"),
        ({"updates": 0}, "updates lies in 1 to"),
        ({"threads": 0}, "threads lies in 1 to"),
        ({"hmis": ()}, "hmis names at least one HMI, but got none"),
        ({"known": 1.1}, r"known lies in \[0, 1\], but got 1\.1"),
        ({"known": float("nan")}, "known lies in"),
        ({"learning_rate": 0.0}, "learning_rate lies in"),
        ({"learning_rate": float("inf")}, "learning_rate lies in"),
        ({"weight_decay": -1.0}, "weight_decay lies in"),
        ({"held_out": 0.0}, r"held_out lies in \(0, 1\)"),
        ({"held_out": 1.0}, r"held_out lies in \(0, 1\)"),
        ({"batch": 1}, r"batch lies in 2 to \d+, .* but got 1"),
        ({"drives": 40, "batch": 39}, r"batch lies in 2 to 38, .* but got 39"),
        ({"reader": NetworkConfig((8,), rnn_hidden_dim=2)}, "set reader.rnn_hidden_dim to 0"),
        ({"place": NetworkConfig((8,), rnn_hidden_dim=2)}, "set place.rnn_hidden_dim to 0"),
        ({"reads": ("speed", "distracted")}, "no part 'distracted' to read"),
        ({"seed": -1}, "a seed lies in"),
    ],
    ids=str,
)
def test_settings_that_make_no_sense_are_refused(changes, told):
    with pytest.raises(ValueError, match=told):
        EvidenceSettings(**changes)
