"""Drive with an HMI, or be one, in the browser: ``hmi-marl play``."""
