"""Compares the solver with known solutions, and a scene's motion on several grids."""
