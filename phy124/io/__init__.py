"""Reads and writes files of Gaussians, clips, videos and paused runs, always atomically."""
