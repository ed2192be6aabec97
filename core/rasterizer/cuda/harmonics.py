"""core.scene.harmonics for one Gaussian per lane, with the gradient."""

import triton
import triton.language as tl

from core.rasterizer.cuda.vectors import add, load_3, load_4, scaled, store_3, store_4
from core.scene import harmonics

SH_0, SH_1 = tl.constexpr(harmonics.SH_0), tl.constexpr(harmonics.SH_1)
SH_20, SH_21, SH_22, SH_23, SH_24 = (tl.constexpr(factor) for factor in harmonics.SH_2)
SH_30, SH_31, SH_32, SH_33, SH_34, SH_35, SH_36 = (tl.constexpr(factor) for factor in harmonics.SH_3)


@triton.jit
def basis(direction, COEFFICIENTS: tl.constexpr):
    """The first COEFFICIENTS (1, 4, 9 or 16) basis functions at a unit direction, or at zero, as a tuple."""
    x, y, z = direction
    terms = (0.0 * x + SH_0,)
    if COEFFICIENTS > 1:
        terms = terms + (y * -SH_1, z * SH_1, x * -SH_1)
    if COEFFICIENTS > 4:
        xx, yy, zz = x * x, y * y, z * z
        terms = terms + (
            x * y * SH_20,
            y * z * SH_21,
            (2 * zz - xx - yy) * SH_22,
            x * z * SH_23,
            (xx - yy) * SH_24,
        )
    if COEFFICIENTS > 9:
        xx, yy, zz = x * x, y * y, z * z
        terms = terms + (
            y * (3 * xx - yy) * SH_30,
            x * y * z * SH_31,
            y * (4 * zz - xx - yy) * SH_32,
            z * (2 * zz - 3 * xx - 3 * yy) * SH_33,
            x * (4 * zz - xx - yy) * SH_34,
            z * (xx - yy) * SH_35,
            x * (xx - 3 * yy) * SH_36,
        )
    return terms


@triton.jit
def direction_gradient(to_basis, direction, COEFFICIENTS: tl.constexpr):
    """dL/d(direction) from dL/d(basis functions), before the direction's normalisation is taken into account."""
    x, y, z = direction
    zero = 0.0 * x
    total = (zero, zero, zero)
    if COEFFICIENTS > 1:
        total = (to_basis[3] * -SH_1, to_basis[1] * -SH_1, to_basis[2] * SH_1)
    if COEFFICIENTS > 4:
        total = add(total, scaled(to_basis[4] * SH_20, (y, x, zero)))
        total = add(total, scaled(to_basis[5] * SH_21, (zero, z, y)))
        total = add(total, scaled(to_basis[6] * SH_22, (-2 * x, -2 * y, 4 * z)))
        total = add(total, scaled(to_basis[7] * SH_23, (z, zero, x)))
        total = add(total, scaled(to_basis[8] * SH_24, (2 * x, -2 * y, zero)))
    if COEFFICIENTS > 9:
        xx, yy, zz = x * x, y * y, z * z
        xy, yz, xz = x * y, y * z, x * z
        total = add(total, scaled(to_basis[9] * SH_30, (6 * xy, 3 * (xx - yy), zero)))
        total = add(total, scaled(to_basis[10] * SH_31, (yz, xz, xy)))
        total = add(total, scaled(to_basis[11] * SH_32, (-2 * xy, 4 * zz - xx - 3 * yy, 8 * yz)))
        total = add(total, scaled(to_basis[12] * SH_33, (-6 * xz, -6 * yz, 6 * zz - 3 * (xx + yy))))
        total = add(total, scaled(to_basis[13] * SH_34, (4 * zz - 3 * xx - yy, -2 * xy, 8 * xz)))
        total = add(total, scaled(to_basis[14] * SH_35, (2 * xz, -2 * yz, xx - yy)))
        total = add(total, scaled(to_basis[15] * SH_36, (3 * (xx - yy), -6 * xy, zero)))
    return total


@triton.jit
def load_sh(sh, row, known, COEFFICIENTS: tl.constexpr):
    """The coefficients of Gaussian `row`, a tuple of (red, green, blue), zeros where `known` is false.

    Rows are far apart, so that every load of a warp touches as many lines of the cache as it has lanes: the fewer
    loads, the better.
    """
    coefficients = ()
    if COEFFICIENTS % 4 == 0:
        for k in tl.static_range(0, COEFFICIENTS, 4):
            at = row * (3 * COEFFICIENTS) + 3 * k
            a, b, c = load_4(sh, at, known), load_4(sh, at + 4, known), load_4(sh, at + 8, known)
            coefficients = coefficients + (
                (a[0], a[1], a[2]),
                (a[3], b[0], b[1]),
                (b[2], b[3], c[0]),
                (c[1], c[2], c[3]),
            )
    else:
        for k in tl.static_range(COEFFICIENTS):
            coefficients = coefficients + (load_3(sh, row * COEFFICIENTS + k, known),)
    return coefficients


@triton.jit
def store_sh(sh, row, terms, colour, known, COEFFICIENTS: tl.constexpr):
    """Write every term times the colour as the coefficients of Gaussian `row`."""
    red, green, blue = colour
    if COEFFICIENTS % 4 == 0:
        for k in tl.static_range(0, COEFFICIENTS, 4):
            at = row * (3 * COEFFICIENTS) + 3 * k
            store_4(sh, at, (terms[k] * red, terms[k] * green, terms[k] * blue, terms[k + 1] * red), known)
            store_4(
                sh, at + 4, (terms[k + 1] * green, terms[k + 1] * blue, terms[k + 2] * red, terms[k + 2] * green), known
            )
            store_4(
                sh, at + 8, (terms[k + 2] * blue, terms[k + 3] * red, terms[k + 3] * green, terms[k + 3] * blue), known
            )
    else:
        for k in tl.static_range(COEFFICIENTS):
            store_3(sh, row * COEFFICIENTS + k, scaled(terms[k], colour), known)


@triton.jit
def colour(sh, row, direction, known, COEFFICIENTS: tl.constexpr):
    """SH + 0.5 of Gaussian `row` (red, green, blue), before the clamp at zero: not finite if a coefficient is not."""
    terms, coefficients = basis(direction, COEFFICIENTS), load_sh(sh, row, known, COEFFICIENTS)
    half = 0.0 * direction[0] + 0.5
    red, green, blue = half, half, half
    for k in tl.static_range(COEFFICIENTS):
        red += terms[k] * coefficients[k][0]
        green += terms[k] * coefficients[k][1]
        blue += terms[k] * coefficients[k][2]
    return red, green, blue


@triton.jit
def is_finite(sh, row, known, COEFFICIENTS: tl.constexpr):
    """Whether every coefficient of Gaussian `row` is a finite number."""
    coefficients, total = load_sh(sh, row, known, COEFFICIENTS), tl.zeros_like(row).to(tl.float32)
    for k in tl.static_range(COEFFICIENTS):
        # 0 times NaN or infinity is NaN, and stays so in the sum.
        total += 0.0 * coefficients[k][0] + 0.0 * coefficients[k][1] + 0.0 * coefficients[k][2]
    return total == 0.0
