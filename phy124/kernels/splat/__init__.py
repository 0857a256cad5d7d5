"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

The stages are project -> bin -> blend, or blend_simd on a CPU; screen holds what they share. Each
file is one Warp module, so a CUDA device never compiles the CPU's native code.
"""
