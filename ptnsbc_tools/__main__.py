"""Entry point of `ptnsbc`: a signal that comes while the commands are loaded ends it as Ctrl-C ends a command."""

from __future__ import annotations

import gc

from ptnsbc_nodes.runtime.signals import exit_on_signal

_INTERRUPTED = 130


def main() -> None:
    """Load the command line and run it."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    gc.disable()  # until a command begins: a help leaves no garbage, and the search for it takes a tenth
    from ptnsbc_tools import cli

    cli.main()


if __name__ == "__main__":
    main()
