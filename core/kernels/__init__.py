"""What kernels are written with: vectors for Numba, how Numba compiles and what it keeps, how Triton launches."""
