"""The positions in a camera's array (core.rasterizer.view), as constants of kernels, which take it in float32."""

import triton.language as tl

from core.rasterizer import view

ROTATION, CENTRE, CENTRE_REST = (tl.constexpr(at) for at in (view.ROTATION, view.CENTRE, view.CENTRE_REST))
FOCAL_X, FOCAL_Y = tl.constexpr(view.FOCAL_X), tl.constexpr(view.FOCAL_Y)
MIDDLE_X, MIDDLE_Y = tl.constexpr(view.MIDDLE_X), tl.constexpr(view.MIDDLE_Y)
LEFT, RIGHT, TOP, BOTTOM = (tl.constexpr(at) for at in (view.LEFT, view.RIGHT, view.TOP, view.BOTTOM))
WIDTH, HEIGHT = tl.constexpr(view.WIDTH), tl.constexpr(view.HEIGHT)
