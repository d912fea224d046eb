"""`ptnsbc network`: the Fast DDS profiles of a fleet on several computers, and a discovery server."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_nodes.runtime import dds_profiles
from ptnsbc_tools import console

app = typer.Typer(
    no_args_is_help=True,
    help="Network profiles for a fleet on several computers, for --network or PTNSBC_NETWORK.",
)

_SERVER = "fast-discovery-server"
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="Write into this file and not to stdout."),
]


@app.command()
def peers(
    hosts: Annotated[
        list[str] | None,
        typer.Argument(metavar="HOST...", help="IPv4 address or name of each computer."),
    ] = None,
    hosts_file: Annotated[
        Path | None,
        typer.Option(
            "--hosts", metavar="FILE", help="File with one HOST per line; # begins a comment."
        ),
    ] = None,
    processes: Annotated[
        int,
        typer.Option(
            "--processes", help="Processes to look for on each computer, viewers included."
        ),
    ] = dds_profiles.PROCESSES,
    output: OutputOption = None,
) -> None:
    """Write a profile that names every computer: no server, no multicast. All computers use the same file."""
    listed = [] if hosts_file is None else _hosts(hosts_file)
    _write(dds_profiles.static_peers([*(hosts or ()), *listed], processes), output)


@app.command()
def server(
    addresses: Annotated[
        list[str],
        typer.Argument(metavar="ADDRESS[:PORT]...", help="Address of each discovery server."),
    ],
    everything: Annotated[
        bool,
        typer.Option(
            "--everything", help="Discover all topics, for `ros2 topic list` and viewers."
        ),
    ] = False,
    output: OutputOption = None,
) -> None:
    """Write a profile for a discovery server: few packets, and computers may join and leave."""
    servers = [dds_profiles.server(address) for address in addresses]
    _write(dds_profiles.discovery_client(servers, everything=everything), output)


@app.command()
def serve(
    address: Annotated[
        str,
        typer.Argument(metavar="ADDRESS[:PORT]", help="Address of this host on which to listen."),
    ],
    number: Annotated[
        int, typer.Option("--id", min=0, max=255, help="Its number in the list of servers.")
    ] = 0,
) -> None:
    """Run a Fast DDS discovery server until Ctrl-C."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    at = dds_profiles.server(address)
    installed = Path(sys.executable).parent / _SERVER  # by the wheels; apt installs it on the path
    program = str(installed) if installed.exists() else shutil.which(_SERVER)
    if program is None:
        raise dds_profiles.NetworkError(
            f"{_SERVER} is not installed: install the extra [ros] or source ROS 2"
        )
    # Without our profile, with which the server would be a client of itself.
    settings = {key: value for key, value in os.environ.items() if key not in _CLIENT_SETTINGS}
    words = [program, "-i", str(number), "-l", at.address, "-p", str(at.port)]
    os.execve(program, words, settings)


_CLIENT_SETTINGS = (
    "FASTRTPS_DEFAULT_PROFILES_FILE",
    "FASTDDS_DEFAULT_PROFILES_FILE",
    "ROS_DISCOVERY_SERVER",
)


def _hosts(file: Path) -> list[str]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise dds_profiles.NetworkError(
            f"{file}: {getattr(error, 'strerror', error)}: expected a file with one host per line"
        ) from None
    return [host for line in lines if (host := line.partition("#")[0].strip())]


def _write(profile: str, output: Path | None) -> None:
    if output is None:
        print(profile)
        return
    from ptnsbc_tools.files import replacing

    with replacing(output) as part:
        part.write_text(f"{profile}\n", encoding="utf-8")
    console.say(f"{output}: give it to --network, or set PTNSBC_NETWORK to it")
