"""Traits of the person at the wheel, measured from recorded trips."""

from hmi_marl.people.measure.person import MeasuredPerson as MeasuredPerson
from hmi_marl.people.measure.person import measure_person as measure_person
from hmi_marl.people.measure.scripted import simulate_calibrations as simulate_calibrations
