"""PPO, by rsl_rl, for one seat or both."""
