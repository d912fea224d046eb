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
from ptnsbc_core.types import Array

_SWEEPS = 12


class Eigen3(NamedTuple):
    """Eigenvalues (3,), unordered, and eigenvectors as the columns of (3, 3)."""

    values: Array
    vectors: Array


@leaf
def dot3(a: Array, b: Array) -> float:
    """Scalar product of two (3,) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@leaf
def norm3(a: Array) -> float:
    """Euclidean norm of a (3,) vector."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@leaf
def cross3(a: Array, b: Array) -> Array:
    """Vector product a x b, (3,)."""
    c = np.empty(3)
    c[0] = a[1] * b[2] - a[2] * b[1]
    c[1] = a[2] * b[0] - a[0] * b[2]
    c[2] = a[0] * b[1] - a[1] * b[0]
    return c


@leaf
def plus(a: Array, b: Array) -> Array:
    """Sum of two (3,) vectors.

    Written out, as everything here: an expression of whole arrays compiles to loops for any shape and
    stride, which made the compiled step three times as large.
    """
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i] + b[i]
    return out


@leaf
def minus(a: Array, b: Array) -> Array:
    """Difference a - b of two (3,) vectors."""
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i] - b[i]
    return out


@leaf
def scaled(factor: float, v: Array) -> Array:
    """A (3,) vector times a number."""
    out = np.empty(3)
    for i in range(3):
        out[i] = factor * v[i]
    return out


@leaf
def divided(v: Array, by: float) -> Array:
    """A (3,) vector divided by a number."""
    out = np.empty(3)
    for i in range(3):
        out[i] = v[i] / by
    return out


@leaf
def moved(a: Array, factor: float, b: Array) -> Array:
    """The (3,) vector a + factor b."""
    out = np.empty(3)
    for i in range(3):
        out[i] = a[i] + factor * b[i]
    return out


@leaf
def part(v: Array, at: int, count: int) -> Array:
    """Copy (count,) of the entries of a vector from `at` on."""
    out = np.empty(count)
    for i in range(count):
        out[i] = v[at + i]
    return out


@leaf
def put(out: Array, at: int, values: Array) -> None:
    """Write a vector into `out` from entry `at` on."""
    for i in range(values.shape[0]):
        out[at + i] = values[i]


@leaf
def times(m: Array, v: Array) -> Array:
    """Product (r, 3) (3,) -> (r,)."""
    out = np.empty(m.shape[0])
    for i in range(m.shape[0]):
        out[i] = m[i, 0] * v[0] + m[i, 1] * v[1] + m[i, 2] * v[2]
    return out


@leaf
def transpose_times(m: Array, v: Array) -> Array:
    """Product of the transpose of m (r, 3) with v (r,) -> (3,)."""
    out = np.zeros(3)
    for i in range(m.shape[0]):
        for j in range(3):
            out[j] += m[i, j] * v[i]
    return out


@leaf
def wrap(angle: float) -> float:
    """Angle [rad] wrapped to [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@leaf
def saturation(x: float, width: float) -> float:
    """(47): slope 1/width inside +-width, sign outside."""
    return min(max(x / width, -1.0), 1.0)


@leaf
def limited(v: Array, limit: float) -> Array:
    """V (3,) scaled down to the norm `limit` where it is longer."""
    length = norm3(v)
    if length > limit:
        return scaled(limit / length, v)
    return v


@kernel
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
def gram3(m: Array) -> Array:
    """Gram matrix of m (r, 3): (3, 3)."""
    out = np.zeros((3, 3))
    for r in range(m.shape[0]):
        for i in range(3):
            for j in range(3):
                out[i, j] += m[r, i] * m[r, j]
    return out
