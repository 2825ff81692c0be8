"""The subcommands of ``hmi-marl``: a typed dataclass each, whose ``run`` calls and prints."""
