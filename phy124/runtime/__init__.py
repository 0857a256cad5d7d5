"""The process phy124 runs in: how Warp starts, signals, time spent, work that can be killed."""
