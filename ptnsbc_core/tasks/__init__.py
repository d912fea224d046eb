"""Tasks: one module each; `contract.py` says what a task is, `registry.py` which there are."""
