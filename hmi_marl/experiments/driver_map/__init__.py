"""Map of when the driver matters."""
