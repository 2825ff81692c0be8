"""Traits of the person at the wheel, measured from recorded trips."""
