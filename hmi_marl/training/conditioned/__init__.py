"""Learning of one HMI for a whole population, conditioned on z, from the exact rules of drivers."""
