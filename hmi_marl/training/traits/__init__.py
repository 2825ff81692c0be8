"""Latent driver traits from driving alone: trait- and preference-aware adversarial IRL."""
