"""Every command of README and docs, run: `python -m docs.commands`."""
