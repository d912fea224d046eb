"""Laws on NumPy vectors: inside the kernels a vector is a tuple, in a test it is easier to calculate with."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np

_LENGTHS = (2, 3)


def on_arrays(law: Callable[..., Any]) -> Callable[..., Any]:
    """The law with vectors of two or three numbers given and returned as arrays."""

    @wraps(law)
    def called(*given: Any) -> Any:
        return arrays(law(*(tuples(one) for one in given)))

    return called


def tuples(value: Any) -> Any:
    """Short arrays as tuples, in a NamedTuple too."""
    if hasattr(value, "_fields"):
        return type(value)(*(tuples(part) for part in value))
    if isinstance(value, np.ndarray) and value.ndim == 1 and len(value) in _LENGTHS:
        return tuple(float(number) for number in value)
    return value


def arrays(value: Any) -> Any:
    """Tuples of numbers as arrays, in a NamedTuple too."""
    if hasattr(value, "_fields"):
        return type(value)(*(arrays(part) for part in value))
    if isinstance(value, tuple):
        parts = [arrays(part) for part in value]
        if any(hasattr(part, "_fields") or isinstance(part, bool) for part in parts):
            return tuple(parts)
        return np.array(parts)
    return value
