"""The table of a sweep for people: shares with their intervals, figures, a page, and two sweeps side by side."""
