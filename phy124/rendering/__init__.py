"""Cameras, the renderer, and the functions that make videos of clips."""
