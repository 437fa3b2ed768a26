"""Results as films and as figures for papers: the same panels, moving or printed."""
