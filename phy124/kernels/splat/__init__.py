"""EWA splatting of 3D Gaussians (Zwicker et al. 2001; Kerbl et al. 2023), one file per stage.

The stages are project -> bin -> blend; screen holds what they share. Files that end in simd are the
forms of CPUs. Each file is one Warp module, so a CUDA device never compiles their native code.
"""
