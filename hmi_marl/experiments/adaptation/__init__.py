"""Unknown drivers: what adaptive HMIs earn of the worth of knowing the driver."""
