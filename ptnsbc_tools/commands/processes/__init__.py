"""Commands that run single processes of a flight, and prepare vehicles and networks for it."""
