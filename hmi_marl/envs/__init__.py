"""The environment: the world, the human model and the protocol. Imports no torch."""
