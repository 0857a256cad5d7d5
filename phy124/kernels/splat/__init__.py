"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

The stages are project, bin and blend; `screen` contains common definitions. Functions whose names
end in `simd` are for CPUs. Functions for CPUs are in separate Warp modules, so that native CPU code
is never compiled for a CUDA device.
"""
