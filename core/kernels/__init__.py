"""What kernels are written with: vectors for Numba, how Numba compiles, how Triton launches; and chosen rows, which all begin with."""
