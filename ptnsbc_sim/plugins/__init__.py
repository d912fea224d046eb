"""Functions of the user in the place of parts of a flight: `hooks` says which, `loader` loads them."""
