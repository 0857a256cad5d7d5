"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

screen (what the stages share) -> project -> bin -> blend, or blend_simd on a CPU. Each file is
one Warp module, so a CUDA device never sees the CPU's native code.
"""
