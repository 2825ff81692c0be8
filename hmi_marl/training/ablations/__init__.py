"""Encoders that differ from the context encoder of trait models in one respect, to compare."""
