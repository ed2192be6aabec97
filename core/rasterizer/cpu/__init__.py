"""The CPU backend: Numba kernels with explicit eight-lane vectors.

backend (the contract, as a torch.autograd.Function) -> project and project_backward (Gaussians to ellipses and back)
-> bin (depth order, tile lists) -> blend_forward and blend_backward (the pixels), over blend (a chunk of eight pixels)
and simd (the vectors), run by core.threads.

Numba's cache is keyed by the file that holds a kernel, not by the files that it calls: after a change in simd,
tuples, footprint, harmonics, blend or the contract's constants delete the `__pycache__` folders here, or the
old machine code goes on running.
"""
