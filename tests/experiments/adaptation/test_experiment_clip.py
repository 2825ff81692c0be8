import pytest
from evidence_models import save_trained, small_evaluation
from PIL import Image

from hmi_marl.experiments.adaptation.evaluation import AdaptSettings
from hmi_marl.experiments.adaptation.experiment import record_change
from hmi_marl.reporting import clip


def test_homer_takes_the_wheel_from_bart_half_way(tmp_path, monkeypatch):
    small_evaluation(monkeypatch)
    shown, moments = [], clip.moments

    def told(*arguments):
        for snapshot, status in moments(*arguments):
            shown.append(status)
            yield snapshot, status

    monkeypatch.setattr(clip, "moments", told)
    path = tmp_path / "adapt.gif"
    record_change(path, "rule", save_trained(tmp_path / "runs"), AdaptSettings())
    half = 5
    assert [status.driver for status in shown] == ["bart"] * (half + 1) + ["homer"] * half
    assert all(sum(p for _, p in status.belief) == pytest.approx(1.0) for status in shown)
    assert shown[0].belief != shown[-1].belief
    with Image.open(path) as image:
        assert image.n_frames == 11
