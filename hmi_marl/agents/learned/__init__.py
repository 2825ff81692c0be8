"""Learned policies and trait models: networks, cards, files and export."""
