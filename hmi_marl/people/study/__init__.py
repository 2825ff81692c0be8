"""The rating study: people rate clips of drivers, and mixed models say what they see."""
