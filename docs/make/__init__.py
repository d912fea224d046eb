"""The parts of pages that are made from the code: `python -m docs.make`."""
