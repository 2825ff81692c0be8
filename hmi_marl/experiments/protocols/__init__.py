"""Protocols compared at equal environment steps and over several seeds."""
