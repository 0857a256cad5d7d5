"""Services of the process: starting Warp, signals, timing, work that can be killed."""
