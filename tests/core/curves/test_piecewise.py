"""Piecewise polynomials against SciPy's."""

import numpy as np
import pytest
from scipy.interpolate import PPoly

from ptnsbc_core.curves.piecewise import polynomial, row_at

STARTS = np.array([0.0, 1.5, 1.75, 4.0])


@pytest.mark.parametrize(
    ("t", "row"), [(-1.0, 0), (0.0, 0), (1.49, 0), (1.5, 1), (3.99, 2), (4.0, 3), (1e6, 3)]
)
def test_row_that_holds(t: float, row: int) -> None:
    assert row_at(STARTS.reshape(-1, 1), t) == row


def test_values_and_derivatives_are_scipys() -> None:
    coefficients = np.random.default_rng(0).normal(size=(2, 4, 8))
    table = np.concatenate([STARTS[:, None], *coefficients], axis=1)
    for channel in (0, 1):
        known = PPoly(coefficients[channel].T, np.array([*STARTS, 6.0]))
        for t in (0.3, 1.6, 2.9, 5.0):
            found = polynomial(table, row_at(table, t), channel, t)
            np.testing.assert_allclose(found, [known(t, order) for order in range(4)], rtol=1e-12)
