"""Demonstrations: recording, datasets, files and environments."""
