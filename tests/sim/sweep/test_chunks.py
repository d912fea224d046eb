"""The table of a chunk: columns made without pandas are those that pyarrow makes."""

from __future__ import annotations

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("pyarrow")

import pyarrow as pa

from ptnsbc_sim.sweep.chunks import _array

KINDS = {
    pa.int64(): st.integers(-(2**63), 2**63 - 1),
    pa.float64(): st.floats(),
    pa.string(): st.text(),
    pa.bool_(): st.booleans(),
}


@pytest.mark.parametrize("kind", KINDS, ids=str)
@given(data=st.data())
def test_a_column_is_that_of_pyarrow(kind, data):
    values = data.draw(st.lists(st.none() | KINDS[kind], max_size=40))
    found, expected = _array(values, kind), pa.array(values, kind)
    found.validate(full=True)
    assert (found.type, found.null_count) == (expected.type, expected.null_count)
    assert repr(found.to_pylist()) == repr(expected.to_pylist())


def test_a_worker_needs_no_pandas():
    told = (
        "import sys, pyarrow as pa; from ptnsbc_sim.sweep.chunks import _array; "
        "_array([1.0, None], pa.float64()); _array(['a', None], pa.string()); "
        "print('pandas' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", told], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"
