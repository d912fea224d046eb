"""The ROS environment of a command: network profile, domain, and the packages that it needs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ptnsbc_core.errors import PtnsbcError

INSTALL = "install the extra [ros] or source ROS 2"


class RosMissingError(PtnsbcError):
    """A package that a command needs is not installed."""


def select_network(network: Path | None, domain: int | None) -> None:
    """Set the environment variables for --network and --domain; child processes inherit them."""
    from ptnsbc_nodes.runtime.environment import NETWORK

    if network is not None:
        os.environ[NETWORK] = str(network)
    if domain is not None:
        os.environ["ROS_DOMAIN_ID"] = str(domain)


def domain_number(domain: int | None) -> int:
    """The domain of a command: that of --domain, or that of the environment."""
    from ptnsbc_nodes.runtime.environment import named_domain

    return named_domain() if domain is None else domain


@contextmanager
def required(advice: str = INSTALL) -> Iterator[None]:
    """Around imports of ROS packages: prepares their environment; a missing package is an error in one line."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    try:
        yield
    except ImportError as error:
        raise RosMissingError(f"{error.name} is not installed: {advice}") from None
