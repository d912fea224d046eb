"""The text of a scenario file: found, read as a tree, completed, and turned into validated blocks."""
