"""The parts of pages that say what the code says, made of the code: `python -m docs.make`."""
