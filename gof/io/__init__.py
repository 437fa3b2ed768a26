"""File formats: our result files, and importers for other methods."""
