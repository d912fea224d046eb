"""Where the tests of the kernels find what they share."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # on_arrays, from the tests of the tasks too
