"""Protocols of training: which policy learns when, with which partner and reward."""
