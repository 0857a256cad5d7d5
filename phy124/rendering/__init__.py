"""Cameras, the renderer, and the framing and filming of clips."""
