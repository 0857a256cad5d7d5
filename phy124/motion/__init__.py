"""Computes the Gaussians of a frame from the motion of the carrying particles."""
