"""Functions for the whole process: starting Warp, signals, timing, and isolated processes."""
