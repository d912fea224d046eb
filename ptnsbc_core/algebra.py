"""Linear algebra for three dimensions, written out.

The kernels do not use NumPy's `@` and `linalg.svd`: numba hands them to BLAS and LAPACK. At this size these cost
more than the laws themselves, and their summation order may depend on memory alignment. Headless flight,
processes and replay must agree bit for bit. `bench` prints both costs.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from ptnsbc_core.kernel import formula, inline_kernel, kernel
from ptnsbc_core.types import Array, Matrix3, Odometry, OdometryLike, Vector2, Vector3, Vector3Like

_SWEEPS = 12


class Eigen3(NamedTuple):
    """Eigenvalues, unordered, and the eigenvector of each."""

    values: Vector3
    vectors: Matrix3


@formula
def dot3(a: Vector3Like, b: Vector3Like) -> float:
    """Scalar product of two (3,) vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@formula
def norm3(a: Vector3Like) -> float:
    """Euclidean norm of a (3,) vector."""
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


@formula
def norm1(a: Vector3Like) -> float:
    """Sum of the magnitudes of a (3,) vector."""
    return abs(a[0]) + abs(a[1]) + abs(a[2])


@formula
def cross3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Vector product a x b."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@formula
def add3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Sum of two (3,) vectors."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@formula
def sub3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Difference a - b of two (3,) vectors."""
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@formula
def scale3(a: float, x: Vector3Like) -> Vector3:
    """Scalar a times a (3,) vector."""
    return a * x[0], a * x[1], a * x[2]


@formula
def div3(x: Vector3Like, a: float) -> Vector3:
    """A (3,) vector divided by a scalar."""
    return x[0] / a, x[1] / a, x[2] / a


@formula
def hadamard3(a: Vector3Like, b: Vector3Like) -> Vector3:
    """Product of two (3,) vectors entry by entry."""
    return a[0] * b[0], a[1] * b[1], a[2] * b[2]


@formula
def axpy(a: float, x: Vector3Like, y: Vector3Like) -> Vector3:
    """The (3,) vector a x + y."""
    return y[0] + a * x[0], y[1] + a * x[1], y[2] + a * x[2]


@formula
def load3(v: Array | tuple[float, ...], at: int) -> Vector3:
    """The (3,) vector that begins at entry `at`."""
    return v[at], v[at + 1], v[at + 2]


@formula
def odometry_tuple(v: OdometryLike) -> Odometry:
    """An odometry vector (13,) as its numbers: kernels read them without asking what was written meanwhile."""
    a, b, c = v[0], v[1], v[2]
    d, e, f, g = v[3], v[4], v[5], v[6]
    return a, b, c, d, e, f, g, v[7], v[8], v[9], v[10], v[11], v[12]


@formula
def store3(out: Array, at: int, v: Vector3Like) -> None:
    """Write a (3,) vector into `out` from entry `at` on."""
    out[at], out[at + 1], out[at + 2] = v[0], v[1], v[2]


@inline_kernel
def store(out: Array, at: int, values: Array) -> None:
    """Write a vector into `out` from entry `at` on."""
    for i in range(values.shape[0]):
        out[at + i] = values[i]


@formula
def matvec(m: Array | Matrix3, v: Vector3Like) -> Vector3:
    """Product (3, 3) (3,)."""
    return dot3(m[0], v), dot3(m[1], v), dot3(m[2], v)


@formula
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
    turned = angle + math.pi
    if 0.0 <= turned < 2.0 * math.pi:  # its remainder is the number itself, and would cost a call
        return turned - math.pi
    return turned % (2.0 * math.pi) - math.pi


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


@formula
def transpose(m: Array | Matrix3) -> Matrix3:
    """The transpose of m (3, 3)."""
    return (
        (m[0][0], m[1][0], m[2][0]),
        (m[0][1], m[1][1], m[2][1]),
        (m[0][2], m[1][2], m[2][2]),
    )


@inline_kernel
def _jacobi_rotation(on_p: float, on_q: float, between: float) -> Vector2:
    """Cosine and sine of the rotation that zeroes `between` = a[p, q], for a[p, p] and a[q, q]."""
    tau = (on_q - on_p) / (2.0 * between)
    tangent = 1.0 / (abs(tau) + math.sqrt(1.0 + tau * tau))
    if tau < 0.0:
        tangent = -tangent
    c = 1.0 / math.sqrt(1.0 + tangent * tangent)
    return c, tangent * c


@formula
def _turned(a: Matrix3, p: int, q: int, turn: Vector2) -> Matrix3:
    """Columns p and q of `a`, given as its columns, turned into each other."""
    c, s = turn
    columns = [a[0], a[1], a[2]]
    columns[p] = sub3(scale3(c, a[p]), scale3(s, a[q]))
    columns[q] = add3(scale3(s, a[p]), scale3(c, a[q]))
    return columns[0], columns[1], columns[2]


@kernel
def eigen3(gram: Matrix3) -> Eigen3:
    """Eigen-decomposition of a symmetric (3, 3) matrix by cyclic Jacobi rotations."""
    a = transpose(gram)  # columns: a[q][p] is the entry in row p and column q
    v = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    for _ in range(_SWEEPS):
        off = abs(a[1][0]) + abs(a[2][0]) + abs(a[2][1])
        if off <= 1e-15 * (abs(a[0][0]) + abs(a[1][1]) + abs(a[2][2])):
            break
        if a[1][0] != 0.0:
            turn = _jacobi_rotation(a[0][0], a[1][1], a[1][0])
            a = transpose(_turned(transpose(_turned(a, 0, 1, turn)), 0, 1, turn))
            v = _turned(v, 0, 1, turn)
        if a[2][0] != 0.0:
            turn = _jacobi_rotation(a[0][0], a[2][2], a[2][0])
            a = transpose(_turned(transpose(_turned(a, 0, 2, turn)), 0, 2, turn))
            v = _turned(v, 0, 2, turn)
        if a[2][1] != 0.0:
            turn = _jacobi_rotation(a[1][1], a[2][2], a[2][1])
            a = transpose(_turned(transpose(_turned(a, 1, 2, turn)), 1, 2, turn))
            v = _turned(v, 1, 2, turn)
    return Eigen3((a[0][0], a[1][1], a[2][2]), v)


@formula
def _outer_added(gram: Matrix3, row: Vector3Like) -> Matrix3:
    a, b, c = row[0], row[1], row[2]
    x, y, z = gram
    return (
        (x[0] + a * a, x[1] + a * b, x[2] + a * c),
        (y[0] + b * a, y[1] + b * b, y[2] + b * c),
        (z[0] + c * a, z[1] + c * b, z[2] + c * c),
    )


@inline_kernel
def gram3(m: Array | Matrix3) -> Matrix3:
    """Gram matrix of m (r, 3): (3, 3)."""
    zero = (0.0, 0.0, 0.0)
    out = (zero, zero, zero)
    for r in range(len(m)):
        out = _outer_added(out, m[r])
    return out
