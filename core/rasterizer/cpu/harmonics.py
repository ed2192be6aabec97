"""core.scene.harmonics for one Gaussian at a time, with the gradient. In float64, which costs the same here."""

import numpy as np

from core.kernels.compiled import part
from core.rasterizer.cpu.vectors import add, scaled
from core.scene.harmonics import SH_0, SH_1, SH_2, SH_3


@part
def fill_basis(basis, direction, coefficients):
    """Write the first `coefficients` (1, 4, 9 or 16) basis functions at a unit direction, or at zero, to `basis`."""
    x, y, z = direction
    basis[0] = SH_0
    if coefficients > 1:
        basis[1] = -SH_1 * y
        basis[2] = SH_1 * z
        basis[3] = -SH_1 * x
    if coefficients > 4:
        xx, yy, zz = x * x, y * y, z * z
        basis[4] = SH_2[0] * x * y
        basis[5] = SH_2[1] * y * z
        basis[6] = SH_2[2] * (2 * zz - xx - yy)
        basis[7] = SH_2[3] * x * z
        basis[8] = SH_2[4] * (xx - yy)
        if coefficients > 9:
            basis[9] = SH_3[0] * y * (3 * xx - yy)
            basis[10] = SH_3[1] * x * y * z
            basis[11] = SH_3[2] * y * (4 * zz - xx - yy)
            basis[12] = SH_3[3] * z * (2 * zz - 3 * xx - 3 * yy)
            basis[13] = SH_3[4] * x * (4 * zz - xx - yy)
            basis[14] = SH_3[5] * z * (xx - yy)
            basis[15] = SH_3[6] * x * (xx - 3 * yy)


@part
def colour(sh, i, basis):
    """SH + 0.5 of Gaussian `i` (red, green, blue), before the clamp at zero: not finite if a coefficient is not."""
    red = green = blue = 0.5
    for k in range(sh.shape[1]):
        red += basis[k] * sh[i, k, 0]
        green += basis[k] * sh[i, k, 1]
        blue += basis[k] * sh[i, k, 2]
    return red, green, blue


@part
def is_finite(sh, i):
    """Whether every coefficient of Gaussian `i` is a finite number."""
    total = np.float32(0)
    for k in range(sh.shape[1]):
        # 0 times NaN or infinity is NaN, and stays so in the sum.
        total += np.float32(0) * sh[i, k, 0] + np.float32(0) * sh[i, k, 1] + np.float32(0) * sh[i, k, 2]
    return total == 0


@part
def direction_gradient(to_basis, direction, coefficients):
    """dL/d(direction) from dL/d(basis functions), before the direction's normalisation is taken into account."""
    x, y, z = direction
    total = (0.0, 0.0, 0.0)
    if coefficients > 1:
        total = (-SH_1 * to_basis[3], -SH_1 * to_basis[1], SH_1 * to_basis[2])
    if coefficients > 4:
        xx, yy, zz = x * x, y * y, z * z
        total = add(total, scaled(SH_2[0] * to_basis[4], (y, x, 0.0)))
        total = add(total, scaled(SH_2[1] * to_basis[5], (0.0, z, y)))
        total = add(total, scaled(SH_2[2] * to_basis[6], (-2 * x, -2 * y, 4 * z)))
        total = add(total, scaled(SH_2[3] * to_basis[7], (z, 0.0, x)))
        total = add(total, scaled(SH_2[4] * to_basis[8], (2 * x, -2 * y, 0.0)))
        if coefficients > 9:
            xy, yz, xz = x * y, y * z, x * z
            total = add(total, scaled(SH_3[0] * to_basis[9], (6 * xy, 3 * (xx - yy), 0.0)))
            total = add(total, scaled(SH_3[1] * to_basis[10], (yz, xz, xy)))
            total = add(total, scaled(SH_3[2] * to_basis[11], (-2 * xy, 4 * zz - xx - 3 * yy, 8 * yz)))
            total = add(total, scaled(SH_3[3] * to_basis[12], (-6 * xz, -6 * yz, 6 * zz - 3 * (xx + yy))))
            total = add(total, scaled(SH_3[4] * to_basis[13], (4 * zz - 3 * xx - yy, -2 * xy, 8 * xz)))
            total = add(total, scaled(SH_3[5] * to_basis[14], (2 * xz, -2 * yz, xx - yy)))
            total = add(total, scaled(SH_3[6] * to_basis[15], (3 * (xx - yy), -6 * xy, 0.0)))
    return total
