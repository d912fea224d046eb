"""Property tests of kernels: a first call compiles, and a failure must come back on the next run."""

from hypothesis import settings

settings.register_profile("kernels", deadline=None, derandomize=True)
settings.load_profile("kernels")
