"""The process of one UAV: inbox, control step, outbox."""
