"""Commands on bags: record, replay, repair."""
