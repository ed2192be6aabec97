"""The CUDA backend: Triton kernels, so that nothing is compiled at install. Imported only when CUDA is asked for.

backend (the contract, as a torch.autograd.Function) -> project and project_backward (Gaussians to ellipses and back,
over view, geometry, harmonics, vectors and footprint) -> bin (depth order, tile lists) -> blend_forward and
blend_backward (the pixels, over blend). Of the same shape as core.rasterizer.cpu, and by the same formulas, but for how
the covariance enters the ellipse's gradient (project_backward); float32 throughout, as the double precision of consumer
cards is 64 times slower.

No kernel uses atomics: a tile writes its sums to slots of its own, which are then added up a Gaussian at a time, so
pictures and gradients are the same bits in every run on one machine. Fused multiply-adds are never left to the
compiler's choice (UNFUSED in triton_launch.py) where kernels have to agree, as counting tiles and listing them: they
could otherwise round differently. Blending agrees forward and backward because what both compute (blend.py) has nothing
left to fuse: its backward pass may fuse what it does with that. Loops are written with `while`: the interpreter of
Triton 3.6 cannot take the bound of a `range` from a tensor under NumPy 2.4. Constants stand on the right of tensors: in
the interpreter of later ones `constant * tensor` is a constant that no function of Triton takes.
"""
