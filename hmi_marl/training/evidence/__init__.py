"""Learning what each turn tells about who drives, from drives with known traits."""
