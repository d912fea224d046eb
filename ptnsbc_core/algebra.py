"""Linear algebra for three dimensions, written out.

The kernels do not use NumPy's `@` and `linalg.svd`: numba hands them to BLAS and LAPACK. At this size these cost
more than the laws themselves, and their summation order may depend on memory alignment. Headless flight,
processes and replay must agree bit for bit. `bench` prints both costs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ptnsbc_core.kernel import inline_kernel, kernel
from ptnsbc_core.types import Array, Matrix3, Vector3, Vector3Like

_SWEEPS = 12


class Eigen3(NamedTuple):
    """Eigenvalues (3,), unordered, and eigenvectors as the columns of (3, 3)."""

    values: Array
    vectors: Array


@inline_kernel
def dot3(a: Vector3Like, b: Vector3Like) -> float:
    """Scalar product of two (3,) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline_kernel
def norm3(a: Vector3Like) -> float:
    """Euclidean norm of a (3,) vector."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@inline_kernel
def norm1(a: Vector3Like) -> float:
    """Sum of the magnitudes of a (3,) vector."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@inline_kernel
def cross3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@inline_kernel
def add3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Sum of two (3,) vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline_kernel
def sub3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Difference a - b of two (3,) vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline_kernel
def scale3(a: float, x: Vector3Like) -> Vector3:
    """Scalar a times a (3,) vector."""
    return a * x[0], a * x[1], a * x[2]


@inline_kernel
def div3(x: Vector3Like, a: float) -> Vector3:
    """A (3,) vector divided by a scalar."""
    return x[0] / a, x[1] / a, x[2] / a


@inline_kernel
def hadamard3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Product of two (3,) vectors entry by entry."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@inline_kernel
def axpy(a: float, x: Vector3Like, y: Vector3Like) -> Vector3:
    """The (3,) vector a x + y."""
    return y[0] + a * x[0], y[1] + a * x[1], y[2] + a * x[2]


@inline_kernel
def load3(v: Vector3Like, at: int) -> Vector3:
    """The (3,) vector that begins at entry `at`."""
    return v[at], v[at + 1], v[at + 2]


@inline_kernel
def store3(out: Array, at: int, v: Vector3Like) -> None:
    """Write a (3,) vector into `out` from entry `at` on."""
    out[at], out[at + 1], out[at + 2] = v[0], v[1], v[2]


@inline_kernel
def store(out: Array, at: int, values: Array) -> None:
    """Write a vector into `out` from entry `at` on."""
    for i in range(values.shape[0]):
        out[at + i] = values[i]


@inline_kernel
def matvec(m: Array | Matrix3, v: Vector3Like) -> Vector3:
    """Product (3, 3) (3,)."""
    return dot3(m[0], v), dot3(m[1], v), dot3(m[2], v)


@inline_kernel
def matvec_transposed(m: Array | Matrix3, v: Vector3Like) -> Vector3:
    """Product of the transpose of m (3, 3) with v (3,)."""
    return (
        m[0][0] * v[0] + m[1][0] * v[1] + m[2][0] * v[2],
        m[0][1] * v[0] + m[1][1] * v[1] + m[2][1] * v[2],
        m[0][2] * v[0] + m[1][2] * v[1] + m[2][2] * v[2],
    )


@inline_kernel
def wrap_angle(angle: float) -> float:
    """Angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@inline_kernel
def saturation(x: float, width: float) -> float:
    """(47): slope 1/width inside +-width, sign outside."""
    return min(max(x / width, -1.0), 1.0)


@inline_kernel
def limit_norm(v: Vector3Like, limit: float) -> Vector3:
    """The vector v (3,), scaled down to the norm `limit` where it is longer."""
    length = norm3(v)
    if length > limit:
        return scale3(limit / length, v)
    return load3(v, 0)


@inline_kernel
def _jacobi_rotation(a: Array, vectors: Array, p: int, q: int) -> None:
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
        _jacobi_rotation(a, vectors, 0, 1)
        _jacobi_rotation(a, vectors, 0, 2)
        _jacobi_rotation(a, vectors, 1, 2)
    for i in range(3):
        values[i] = a[i, i]
    return Eigen3(values, vectors)


@inline_kernel
def gram3(m: Array | Matrix3) -> Array:
    """Gram matrix of m (r, 3): (3, 3)."""
    out = np.zeros((3, 3))
    for r in range(len(m)):
        for i in range(3):
            for j in range(3):
                out[i, j] += m[r][i] * m[r][j]
    return out
