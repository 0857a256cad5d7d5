"""How the Gaussians of a frame follow from the motion of the particles that carry them."""
