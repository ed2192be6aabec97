"""The CPU backend: Numba kernels with explicit eight-lane vectors.

backend (the contract, as a torch.autograd.Function) -> project and project_backward (Gaussians to ellipses and back,
over view, harmonics and vectors) -> bin (depth order, tile lists, over footprint: which tiles an ellipse touches) ->
blend_forward and blend_backward (the pixels), over blend (a chunk of eight pixels) and core.kernels.simd (the eight
lanes), run by core.system.threads. core.rasterizer.layout says what a footprint is.
"""
