"""Small linear algebra for three dimensions, written out.

Why not NumPy inside the kernels: numba hands `@` and `linalg.svd` to BLAS and LAPACK, which costs more than
the laws themselves at this size and whose summation order may depend on memory alignment, while headless
flight, processes and replay must agree bit for bit. `bench` prints both costs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import kernel, leaf
from ptnsbc_core.types import Array, Matrix3, Triple, Vector3

_SWEEPS = 12


class Eigen3(NamedTuple):
    """Eigenvalues (3,), unordered, and eigenvectors as the columns of (3, 3)."""

    values: Array
    vectors: Array


@leaf
def dot3(a: Triple, b: Triple) -> float:
    """Scalar product of two (3,) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def norm3(a: Triple) -> float:
    """Euclidean norm of a (3,) vector."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@leaf
def cross3(a: Triple, b: Triple) -> Vector3:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@leaf
def plus(a: Triple, b: Triple) -> Vector3:
    """Sum of two (3,) vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@leaf
def minus(a: Triple, b: Triple) -> Vector3:
    """Difference a - b of two (3,) vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@leaf
def scaled(factor: float, v: Triple) -> Vector3:
    """A (3,) vector times a number."""
    return factor * v[0], factor * v[1], factor * v[2]


@leaf
def divided(v: Triple, by: float) -> Vector3:
    """A (3,) vector divided by a number."""
    return v[0] / by, v[1] / by, v[2] / by


@leaf
def moved(a: Triple, factor: float, b: Triple) -> Vector3:
    """The (3,) vector a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@leaf
def three(v: Triple, at: int) -> Vector3:
    """Three entries of a vector from `at` on."""
    return v[at], v[at + 1], v[at + 2]


@leaf
def put3(out: Array, at: int, v: Triple) -> None:
    """Write a (3,) vector into `out` from entry `at` on."""
    out[at], out[at + 1], out[at + 2] = v[0], v[1], v[2]


@leaf
def put(out: Array, at: int, values: Array) -> None:
    """Write a vector into `out` from entry `at` on."""
    for i in range(values.shape[0]):
        out[at + i] = values[i]


@leaf
def times(m: Array | Matrix3, v: Triple) -> Vector3:
    """Product (3, 3) (3,)."""
    return dot3(m[0], v), dot3(m[1], v), dot3(m[2], v)


@leaf
def transpose_times(m: Array | Matrix3, v: Triple) -> Vector3:
    """Product of the transpose of m (3, 3) with v (3,)."""
    return (
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    )


@leaf
def wrap(angle: float) -> float:
    """Angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@leaf
def saturation(x: float, width: float) -> float:
    """(47): slope 1/width inside +-width, sign outside."""
    return min(max(x / width, -1.0), 1.0)


@leaf
def limited(v: Triple, limit: float) -> Vector3:
    """V (3,) scaled down to the norm `limit` where it is longer."""
    length = norm3(v)
    if length > limit:
        return scaled(limit / length, v)
    return three(v, 0)


@leaf
def _rotate(a: Array, vectors: Array, p: int, q: int) -> None:
    """One Jacobi rotation that zeroes a[p, q], applied to `a` and `vectors` in place."""
    if a[p, q] == 0.0:
        return
    tau = (a[q, q] - a[p, p]) / (2.0 * a[p, q])
    tangent = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
    if tau < 0.0:
        tangent = -tangent
    c = 1.0 / math.sqrt(1.0 + tangent * tangent)
    s = tangent * c
    for k in range(3):
        x, y = a[k, p], a[k, q]
        a[k, p], a[k, q] = c * x - s * y, s * x + c * y
    for k in range(3):
        x, y = a[p, k], a[q, k]
        a[p, k], a[q, k] = c * x - s * y, s * x + c * y
    for k in range(3):
        x, y = vectors[k, p], vectors[k, q]
        vectors[k, p], vectors[k, q] = c * x - s * y, s * x + c * y


@kernel
def eigen3(gram: Array) -> Eigen3:
    """Eigen-decomposition of a symmetric (3, 3) matrix by cyclic Jacobi rotations."""
    a = gram.copy()
    vectors = np.zeros((3, 3))
    values = np.empty(3)
    for i in range(3):
        vectors[i, i] = 1.0
    for _ in range(_SWEEPS):
        off = abs(a[0, 1]) + abs(a[0, 2]) + abs(a[1, 2])
        if off <= 1e-15 * (abs(a[0, 0]) + abs(a[1, 1]) + abs(a[2, 2])):
            break
        _rotate(a, vectors, 0, 1)
        _rotate(a, vectors, 0, 2)
        _rotate(a, vectors, 1, 2)
    for i in range(3):
        values[i] = a[i, i]
    return Eigen3(values, vectors)


@leaf
def gram3(m: Array | Matrix3) -> Array:
    """Gram matrix of m (r, 3): (3, 3)."""
    out = np.zeros((3, 3))
    for r in range(len(m)):
        for i in range(3):
            for j in range(3):
                out[i, j] += m[r][i] * m[r][j]
    return out
