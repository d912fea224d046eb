"""Tasks: one module each; `contract.py` says what a task is, `table.py` which there are, `registry.py` chooses."""
