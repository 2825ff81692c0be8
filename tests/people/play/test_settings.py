import pytest

from hmi_marl.envs.config import TeamSettings
from hmi_marl.people.play.settings import PlaySettings


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"hmis": ()}, "hmis takes at least one name"),
        ({"drivers": "bart"}, "drivers takes at least one name"),
        ({"seats": ("driver", "driver")}, "seats are different names"),
        ({"seats": ("passenger",)}, "passenger"),
        ({"calibration_trips": 0}, "calibration_trips lies in 1"),
        ({"trial_trips": 31}, "trial_trips lies in 1 to 30"),
    ],
)
def test_settings_that_make_no_sense_are_refused(given, reason):
    with pytest.raises(ValueError, match=reason):
        PlaySettings(**given)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"hmis": ("optimul",)}, "unknown HMI 'optimul'"),
        ({"driver_policies": ("never",)}, "unknown driver policy 'never'"),
        ({"drivers": ("barb",)}, "barb"),
        ({"team": TeamSettings(duration=0.33)}, "duration = 0.33 s is not a whole number"),
    ],
)
def test_names_are_checked_before_a_visitor_comes(given, reason):
    with pytest.raises(ValueError, match=reason):
        PlaySettings(**given).check()


def test_graded_alerts_are_played_but_not_measured():
    graded = PlaySettings(TeamSettings(alert_strengths=(0.5, 1.0)))
    assert not graded.measures
    graded.check()
    assert graded.config("vehicle_ai", "bart").alerts.choices == 3
    assert PlaySettings().measures
