"""The process phy124 runs in: starting Warp, signals, timing, work that can be killed."""
