"""The process that integrates the vehicles, in real time or in lock-step."""
