"""Command filter and time-base-generator sliding-mode controllers for both plants."""
