"""The experiments of `ptnsbc reproduce`: one module each, with a function `run`."""
