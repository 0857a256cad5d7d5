"""Computes the Gaussians of a frame from the motion of the particles that carry them."""
