"""The traffic between processes: topics, quality of service, messages, the communication graph."""
