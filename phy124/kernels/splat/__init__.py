"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

The stages are project, bin and blend; `screen` holds their common definitions. Names that end in
`simd` are the CPU forms. Each form is in a separate Warp module, so native CPU code is never
compiled for a CUDA device.
"""
