"""`ptnsbc node`: one process of a flight by itself."""
