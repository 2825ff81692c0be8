"""Evidence models: inference of the driver, learned from drives with known traits."""
