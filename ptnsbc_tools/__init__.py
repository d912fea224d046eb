"""The command line, pre-flight check, verification, reports and sweeps."""
