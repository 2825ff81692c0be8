"""Trainings over lists and ranges of any of their options, by protocol and seed."""
