"""The figures that the README quotes, each measured beside a reference: `make bench`."""
