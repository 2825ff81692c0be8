"""Who drives, by exact Bayes, with a driver policy and with a control that reads less."""
