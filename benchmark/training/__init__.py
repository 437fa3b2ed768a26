"""Learning what the reconstruction ships with."""
