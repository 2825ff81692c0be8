"""Latent traits and exact posteriors of drivers who differ from those that they were made for."""
