"""Device code and only device code: Warp functions and kernels, one formula per function."""
