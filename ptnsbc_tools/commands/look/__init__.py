"""Commands that judge, compare and show recorded flights."""
