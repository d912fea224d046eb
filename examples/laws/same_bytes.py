"""Two bags compared, message by message and byte for byte: python same_bytes.py A B."""

import sys
from pathlib import Path

from ptnsbc_io.bag import read_bag

first, second = (list(read_bag(Path(path)).messages()) for path in sys.argv[1:3])
print(f"{len(first)} and {len(second)} messages, the same: {first == second}")
sys.exit(first != second)
