"""What travels between processes: topics, quality of service, messages, the communication graph."""
