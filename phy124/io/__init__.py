"""Reads and writes files of Gaussians, clips, videos and paused runs; every file is written
atomically.
"""
