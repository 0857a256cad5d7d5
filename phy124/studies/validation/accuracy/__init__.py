"""Compares the solver with known solutions, and compares a scene's motions on several grids."""
