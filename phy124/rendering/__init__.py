"""The cameras, the renderer, and the functions that frame and film clips."""
