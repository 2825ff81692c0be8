import json
from dataclasses import replace

import pytest
from people.guests import settings

from hmi_marl.people.measure.hmis import TRIAL
from hmi_marl.people.play.visits import Visit, VisitError

PERSON = {"hmis": {name: {"partner": f"optimal-{name}"} for name in TRIAL}}


def through(visit, chosen, trips):
    """Begin and end so many trips; the plans."""
    plans = []
    for number in trips:
        plans.append(visit.plan(chosen))
        visit = Visit.from_json(json.loads(json.dumps(visit.begin(number).to_json())))
        assert visit.stage(chosen) == "trip"
        visit = visit.finish()
    return visit, plans


def test_a_visit_goes_from_the_calibration_to_the_result():
    chosen = settings(calibration_trips=2, trial_trips=2)
    visit = Visit(7)
    assert visit.stage(chosen) == "welcome"
    visit = visit.choose_measured(chosen)
    visit, plans = through(visit, chosen, (1, 2))
    assert [plan.kind for plan in plans] == ["calibration"] * 2
    assert plans[0].partner.startswith("random:0.")
    assert plans[0].seed != plans[1].seed
    assert visit.stage(chosen) == "measuring"
    with pytest.raises(ValueError, match="no trip to begin now"):
        visit.plan(chosen)
    visit = visit.measured(PERSON, chosen)
    assert sorted(visit.hmis) == sorted(TRIAL)
    visit, first = through(visit, chosen, (3,))
    chosen = settings(calibration_trips=2, trial_trips=1)  # a server started anew
    visit, plans = through(visit, chosen, range(4, 9))
    plans = first + plans
    assert [plan.partner for plan in plans] == [
        f"optimal-{name}" for name in visit.hmis for _ in range(2)
    ]
    assert [visit.of_hmi(name) for name in visit.hmis] == [(3, 4), (5, 6), (7, 8)]
    assert visit.stage(chosen) == "result"
    assert visit.own_trips == tuple(range(1, 9))
    assert visit.judged({"a": 1}).judged({"a": 2}).result == {"a": 1}
    assert visit.measured({"hmis": {}}, chosen) == visit


def test_calibration_and_trial_go_on_with_one_team():
    chosen, other = settings(calibration_trips=2), settings(calibration_trips=2, duration=2.0)
    visit, (first,) = through(Visit(7).choose_measured(chosen), chosen, (1,))
    again = visit.plan(other, first.config)
    assert (again.config, again.partner) == (first.config, first.partner)
    visit = replace(visit.begin(2).finish(), person=PERSON, order=TRIAL)
    assert visit.plan(other, first.config).config == first.config
    assert visit.plan(other).config == other.config("driver")


def test_a_partner_that_is_no_longer_offered_is_refused():
    chosen = settings()
    visit = Visit(7).choose_free(chosen, "vehicle_ai", "rule", "bart")
    assert visit.plan(chosen).partner == "rule"
    for other in (
        settings(drivers=("lisa",)),
        settings(driver_policies=("random",)),
        settings(seats=("driver",)),
    ):
        with pytest.raises(VisitError, match="there is no"):
            visit.plan(other)


def test_six_visitors_meet_the_hmis_in_six_orders():
    chosen = settings(calibration_trips=1)
    orders = set()
    for visitor in range(1, 7):
        visit, _ = through(Visit(visitor).choose_measured(chosen), chosen, (1,))
        orders.add(visit.measured(PERSON, chosen).order)
    assert len(orders) == 6


def test_free_trips_in_either_seat():
    chosen = settings()
    visit = Visit(1).choose_free(chosen, "vehicle_ai", "rule", "bart")
    visit, plans = through(visit, chosen, (1, 2))
    assert {plan.kind for plan in plans} == {"free"}
    assert plans[0].config.only_driver.name == "bart"
    assert visit.free == (1, 2)
    visit = visit.choose_free(chosen, "driver", "never", "ignored")
    assert visit.plan(chosen).partner == "never"
    assert visit.stage(chosen) == "over"


def test_a_trip_that_is_stopped_is_not_counted():
    chosen = settings()
    visit = Visit(1).choose_measured(chosen).begin(5)
    for change in (
        lambda: visit.choose_measured(chosen),
        lambda: visit.choose_free(chosen, "driver", "never", ""),
        lambda: visit.begin(6),
    ):
        with pytest.raises(ValueError, match="a trip is under way; end it first"):
            change()
    stopped = visit.stop()
    assert stopped.stage(chosen) == "welcome"
    assert stopped.own_trips == ()
    assert (
        stopped.choose_measured(chosen).plan(chosen).seed
        != Visit(1).choose_measured(chosen).plan(chosen).seed
    )
    with pytest.raises(ValueError, match="no trip under way"):
        stopped.finish()


@pytest.mark.parametrize(
    ("choice", "reason"),
    [
        (("passenger", "never", ""), "no seat 'passenger'"),
        (("driver", "rule", ""), "no partner 'rule'"),
        (("vehicle_ai", "never", "bart"), "no partner 'never'"),
        (("vehicle_ai", "rule", "average"), "no driver 'average'"),
        (("vehicle_ai", "rule", ""), "no driver ''"),
    ],
)
def test_what_is_not_offered_is_refused(choice, reason):
    with pytest.raises(ValueError, match=reason):
        Visit(1).choose_free(settings(), *choice)


def test_graded_alerts_or_one_seat_leave_no_calibration():
    only = settings(seats=("vehicle_ai",))
    assert not only.measures
    with pytest.raises(ValueError, match="no calibration"):
        Visit(1).choose_measured(only)
    with pytest.raises(ValueError, match="no seat 'driver'"):
        Visit(1).choose_free(only, "driver", "never", "")


@pytest.mark.parametrize("content", [None, [], {}, {"visitor": 1}, {"visitor": "x"}])
def test_a_state_that_is_none_is_refused(content):
    with pytest.raises(ValueError, match=r"visitor|mapping|field|lacks"):
        Visit.from_json(content)
