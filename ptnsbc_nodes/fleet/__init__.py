"""All processes of one flight: start, supervise, coordinate, end."""
