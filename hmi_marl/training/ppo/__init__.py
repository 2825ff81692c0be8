"""PPO, with rsl_rl's models and losses, for one seat or both."""
