"""The live view: the report's page fed over a socket of this host, and the dashboard in the terminal."""
