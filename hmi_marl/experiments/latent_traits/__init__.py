"""Latent traits learned in the paper's three settings, and what they hold."""
