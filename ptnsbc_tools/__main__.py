"""Entry point of `ptnsbc`: a signal that comes while the commands are loaded ends it as Ctrl-C ends a command."""

from __future__ import annotations

import atexit
import gc

from ptnsbc_nodes.runtime.signals import exit_on_signal

_INTERRUPTED = 130
# Python looks for garbage among so many new objects, by itself among 700. Modules that are loaded leave none.
_NEW_OBJECTS = 10_000


def main() -> None:
    """Load the command line and run it."""
    exit_on_signal(_INTERRUPTED, "interrupted")
    gc.set_threshold(_NEW_OBJECTS)
    atexit.register(gc.freeze)  # nor is there any to look for when the whole memory is given back
    from ptnsbc_tools import cli

    cli.main()


if __name__ == "__main__":
    main()
