"""The figures that the pages quote, each measured beside a reference: `make bench`."""
