"""Property tests of kernels: a first call compiles, and a failure must come back on the next run."""

import sys
from pathlib import Path

from hypothesis import settings

settings.register_profile("kernels", deadline=None, derandomize=True)
settings.load_profile("kernels")

sys.path.insert(0, str(Path(__file__).parent))  # on_arrays, from the tests of the tasks too
