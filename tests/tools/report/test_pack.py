"""What the page unpacks is what was packed."""

import base64
import gzip
import json
import struct

import numpy as np

from ptnsbc_tools.report.pack import Pack


def test_text_and_arrays_come_back():
    pack = Pack()
    first = pack.add(np.arange(6.0).reshape(2, 3))
    second = pack.add(np.array([np.nan, -1.5]))
    data = gzip.decompress(base64.b64decode(pack.encode({"name": "café", "at": second})))
    (size,) = struct.unpack_from("<I", data)
    assert json.loads(data[4 : 4 + size]) == {"name": "café", "at": [6, 2]}
    assert size % 4 == 0  # the floats behind it must be aligned
    floats = np.frombuffer(data, "<f4", offset=4 + size)
    assert first == [0, 6]
    np.testing.assert_array_equal(floats[:6], np.arange(6.0))
    np.testing.assert_array_equal(floats[6:], np.float32([np.nan, -1.5]))
