"""Exact solutions: the alert optimum, the Bayes filter of the driver and of d, the posterior."""
