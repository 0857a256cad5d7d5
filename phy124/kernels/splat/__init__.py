"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

Functions for CPUs (`simd`) are in separate Warp modules, so that native CPU code is never compiled
for a CUDA device.
"""
