"""Training: policies of both seats, latent traits and evidence models."""
