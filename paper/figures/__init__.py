"""The figures of `ptnsbc reproduce`."""
