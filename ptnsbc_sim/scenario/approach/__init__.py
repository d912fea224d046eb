"""The approach from the starts to the places: its limits, its shortest deadline, and the turn that it takes."""
