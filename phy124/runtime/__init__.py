"""Functions for the whole process: starting Warp, signals, time measurement, and work that can be
killed.
"""
