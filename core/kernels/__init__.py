"""What kernels are written with: vectors for Numba, how Numba compiles, how Triton launches."""
