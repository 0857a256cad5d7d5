"""Generators with trained networks, which nothing outside this folder imports."""
