"""Known solutions, and one scene on a series of grids."""
