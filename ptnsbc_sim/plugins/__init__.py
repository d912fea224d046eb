"""Functions of the user in the place of parts of a flight: `hooks` says which, `loader` loads them."""

USER_CODE, NAMED, REFUSED = "PTNSBC_USER_CODE", "named", "refused"
"""Environment variable of a command and its processes: the files of users are named before they run, or none runs."""
