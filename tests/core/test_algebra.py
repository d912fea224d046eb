"""The written-out algebra against NumPy."""

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from on_arrays import on_arrays

from ptnsbc_core.algebra import (
    cross3,
    dot3,
    eigen3,
    gram3,
    limit_norm,
    matvec,
    matvec_transposed,
    norm3,
    saturation,
    wrap_angle,
)

cross3 = on_arrays(cross3)
limit_norm = on_arrays(limit_norm)
matvec = on_arrays(matvec)
matvec_transposed = on_arrays(matvec_transposed)

numbers = st.floats(-10.0, 10.0).map(lambda x: 0.0 if abs(x) < 1e-6 else x)
vectors = arrays(np.float64, 3, elements=numbers)
matrices = st.integers(1, 5).flatmap(lambda rows: arrays(np.float64, (rows, 3), elements=numbers))


@given(a=vectors, b=vectors)
def test_products_of_vectors(a: np.ndarray, b: np.ndarray) -> None:
    assert dot3(a, b) == pytest.approx(a @ b, abs=1e-12)
    assert norm3(a) == pytest.approx(np.linalg.norm(a))
    np.testing.assert_allclose(cross3(a, b), np.cross(a, b), atol=1e-12)


@given(m=arrays(np.float64, (3, 3), elements=numbers), v=vectors)
def test_products_of_matrices(m: np.ndarray, v: np.ndarray) -> None:
    np.testing.assert_allclose(matvec(m, v), m @ v, atol=1e-11)
    np.testing.assert_allclose(matvec_transposed(m, v), m.T @ v, atol=1e-11)


@given(m=matrices)
def test_gram_matrix(m: np.ndarray) -> None:
    np.testing.assert_allclose(gram3(m), m.T @ m, atol=1e-11)


@given(m=matrices)
def test_eigen_decomposition(m: np.ndarray) -> None:
    values, vectors = eigen3(gram3(m))
    gram = np.array(gram3(m))
    vectors3 = np.array(vectors).T  # as columns
    size = max(np.abs(gram).max(), 1e-12)
    np.testing.assert_allclose(vectors3 @ vectors3.T, np.eye(3), atol=1e-13)
    np.testing.assert_allclose(vectors3 @ np.diag(values) @ vectors3.T, gram, atol=1e-13 * size)
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(gram), atol=1e-12 * size)


@pytest.mark.parametrize(
    "gram", [np.zeros((3, 3)), np.eye(3), np.ones((3, 3)), np.diag([1e8, 1.0, 1e-8])]
)
def test_eigen_decomposition_of_special_matrices(gram: np.ndarray) -> None:
    values, vectors = eigen3(tuple(tuple(row.tolist()) for row in gram))
    vectors3 = np.array(vectors).T
    np.testing.assert_allclose(np.sort(values), np.linalg.eigvalsh(gram), atol=1e-14, rtol=1e-9)
    np.testing.assert_allclose(vectors3 @ vectors3.T, np.eye(3), atol=1e-14)


@given(angle=st.floats(-100.0, 100.0))
def test_wrap(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -np.pi <= wrapped < np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-12)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-12)


@given(angle=st.floats(-20.0, 20.0) | st.sampled_from([-np.pi, np.pi, 0.0, -0.0, 3.0 * np.pi]))
def test_wrap_is_the_remainder_to_the_last_bit(angle: float) -> None:
    whole = (angle + math.pi) % (2.0 * math.pi) - math.pi
    assert struct.pack("d", wrap_angle(angle)) == struct.pack("d", whole)


def test_wrap_by_hand() -> None:
    assert wrap_angle(3.5) == pytest.approx(3.5 - 2.0 * np.pi)
    assert wrap_angle(np.pi) == -np.pi


@given(x=st.floats(-5.0, 5.0), width=st.floats(0.01, 3.0))
def test_saturation_is_47(x: float, width: float) -> None:
    printed = (abs(x + width) - abs(x - width)) / (2.0 * width)
    assert saturation(x, width) == pytest.approx(printed, abs=1e-9)


@given(v=vectors, limit=st.floats(0.1, 5.0))
def test_limited_keeps_the_direction(v: np.ndarray, limit: float) -> None:
    out = limit_norm(v, limit)
    assert norm3(out) <= limit * (1.0 + 1e-12)
    np.testing.assert_allclose(np.cross(out, v), np.zeros(3), atol=1e-10)
    if norm3(v) <= limit:
        np.testing.assert_array_equal(out, v)
