"""Commands to begin with: write, list and check scenarios, examine the computer."""
