"""Ablations of the self-supervised encoder: one part changed at a time."""
