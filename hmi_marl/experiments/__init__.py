"""Experiments: each learns, plays, judges by criteria and describes its report."""
