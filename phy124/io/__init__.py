"""Files of Gaussians, clips, videos and paused runs; each appears whole or not at all."""
