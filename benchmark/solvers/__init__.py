"""Where flames come from: what a solver hands over (`grids`), how real it is (`physics`), and the solvers."""
