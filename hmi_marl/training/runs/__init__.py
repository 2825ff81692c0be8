"""Runs in a folder: claimed, resumed, saved, and several in parallel."""
