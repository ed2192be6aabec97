"""What comes before and after the matrix products of the SH transfer, in Numba:
torch's passes took longer than the products.

A strip of rows is in cache while they work on it. Numba may contract a product and a sum into one instruction
here; a row's result does not depend on the other rows.
"""

import numpy as np

from core.kernels.compiled import part

# tanh x = x P(x^2) / Q(x^2), fitted on [0, SATURATED] for the least relative error, 2e-8; beyond it float32 rounds tanh
# to 1.
SATURATED = np.float32(9.0)
P_0, P_1, P_2, P_3, P_4 = map(
    np.float32, (9.9999998e-01, 1.33810681e-01, 3.49563718e-03, 2.06098358e-05, 1.33555958e-08)
)
Q_1, Q_2, Q_3, Q_4 = map(np.float32, (4.67143837e-01, 2.58771722e-02, 3.28571276e-04, 7.77696447e-07))
ONE, TWO = np.float32(1.0), np.float32(2.0)
# Taylor's series of sin and cos at (pi / 2) x, in powers of x^2; the first term left out is below 1e-8 for |x| <= 1.
QUARTER_TURN = np.pi / 2
FACTORIALS = np.cumprod(np.array([1.0, *range(1, 15)]))
S_0, S_1, S_2, S_3, S_4, S_5, S_6 = ((-1) ** k * QUARTER_TURN ** (2 * k + 1) / FACTORIALS[2 * k + 1] for k in range(7))
C_1, C_2, C_3, C_4, C_5, C_6, C_7 = ((-1) ** k * QUARTER_TURN ** (2 * k) / FACTORIALS[2 * k] for k in range(1, 8))


@part
def bound_softly(values, bound, base, output):
    """output = bound * tanh(values / bound), plus `base` unless that is empty; (n,) float32. NaN stays NaN."""
    inverse = ONE / bound
    for i in range(len(output)):
        x = values[i] * inverse
        if x > SATURATED:
            x = SATURATED
        elif x < -SATURATED:
            x = -SATURATED
        square = x * x
        above = x * (P_0 + square * (P_1 + square * (P_2 + square * (P_3 + square * P_4))))
        below = ONE + square * (Q_1 + square * (Q_2 + square * (Q_3 + square * Q_4)))
        y = above / below
        if y > ONE:
            y = ONE
        elif y < -ONE:
            y = -ONE
        output[i] = bound * y
    # On its own: contracted with the product, the sum would be rounded once less than the live look's.
    for i in range(len(base)):
        output[i] = base[i] + output[i]


@part
def encode_positions(means, octaves, encoded):
    """positional_encoding.encode(contract(means), octaves) of float32 means (n, 3),
    transposed into `encoded` (columns, >= n) float32.

    Sine and cosine of pi x follow from those of pi x / 2 as an octave follows from the one below it. A loop runs along
    the Gaussians and does one thing, so that the compiler makes vectors of it.
    """
    count = len(means)
    for i in range(count):
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        norm = max(np.sqrt(x * x + y * y + z * z), 1.0)
        shrink = (1.0 - 0.5 / norm) / norm
        encoded[0, i], encoded[1, i], encoded[2, i] = x * shrink, y * shrink, z * shrink
    for axis in range(3 if octaves else 0):
        values, sines, cosines = encoded[axis], encoded[3 + axis], encoded[6 + axis]
        for i in range(count):
            value = np.float64(values[i])
            square = value * value
            sine = S_3 + square * (S_4 + square * (S_5 + square * S_6))
            sine = value * (S_0 + square * (S_1 + square * (S_2 + square * sine)))
            cosine = C_4 + square * (C_5 + square * (C_6 + square * C_7))
            cosine = 1.0 + square * (C_1 + square * (C_2 + square * (C_3 + square * cosine)))
            sines[i], cosines[i] = 2.0 * sine * cosine, 1.0 - 2.0 * sine * sine
    for row in range(3, 3 + 6 * (octaves - 1)):
        if row % 6 < 3:
            continue  # cosines are made with the sines before them
        sines, cosines, next_sines, next_cosines = encoded[row], encoded[row + 3], encoded[row + 6], encoded[row + 9]
        for i in range(count):
            next_sines[i] = TWO * sines[i] * cosines[i]
            next_cosines[i] = ONE - TWO * sines[i] * sines[i]
    encoded[:, count:] = 0
