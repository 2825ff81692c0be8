"""Learning of one HMI for a whole population, conditioned on z, from expected values."""
