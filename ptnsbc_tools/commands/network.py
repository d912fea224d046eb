"""`ptnsbc network`: the Fast DDS profiles of a fleet on several computers, and a discovery server."""

from __future__ import annotations

import os
import shutil
import sys
from pathlib import Path
from typing import Annotated

import typer

from ptnsbc_nodes.runtime import dds_profiles

app = typer.Typer(
    no_args_is_help=True,
    help="Profiles for a fleet on several computers; give one to --network or PTNSBC_NETWORK.",
)

_SERVER = "fast-discovery-server"
OutputOption = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="FILE", help="Write it there instead of printing it."),
]


@app.command()
def peers(
    hosts: Annotated[
        list[str] | None,
        typer.Argument(metavar="HOST...", help="IPv4 address or name of each computer."),
    ] = None,
    hosts_file: Annotated[
        Path | None,
        typer.Option("--hosts", metavar="FILE", help="A file with one HOST per line, # comments."),
    ] = None,
    processes: Annotated[
        int,
        typer.Option("--processes", help="How many to look for on each computer, viewers too."),
    ] = dds_profiles.PROCESSES,
    output: OutputOption = None,
) -> None:
    """Every computer knows all the others: no server, no multicast. The same file on all of them."""
    listed = [] if hosts_file is None else _hosts(hosts_file)
    _put(dds_profiles.static_peers([*(hosts or ()), *listed], processes), output)


@app.command()
def server(
    addresses: Annotated[
        list[str], typer.Argument(metavar="ADDRESS[:PORT]...", help="Of each discovery server.")
    ],
    everything: Annotated[
        bool,
        typer.Option("--everything", help="Learn of all topics: for `ros2 topic list`, viewers."),
    ] = False,
    output: OutputOption = None,
) -> None:
    """Processes find each other through a discovery server: few packets, computers may come and go."""
    servers = [dds_profiles.server(address) for address in addresses]
    _put(dds_profiles.discovery_client(servers, everything=everything), output)


@app.command()
def serve(
    address: Annotated[
        str, typer.Argument(metavar="ADDRESS[:PORT]", help="Where to listen: one of this host's.")
    ],
    number: Annotated[
        int, typer.Option("--id", min=0, max=255, help="Its place in the list of servers.")
    ] = 0,
) -> None:
    """Run a Fast DDS discovery server until Ctrl-C."""
    from ptnsbc_nodes.runtime import environment

    environment.prepare()
    place = dds_profiles.server(address)
    beside = (
        Path(sys.executable).parent / _SERVER
    )  # the wheels; with ROS from apt it is on the path
    program = str(beside) if beside.exists() else shutil.which(_SERVER)
    if program is None:
        raise dds_profiles.NetworkError(
            f"{_SERVER} is not installed: install the extra [ros] or source ROS 2"
        )
    # No profile of ours: the server would read it and be a client of itself.
    settings = {key: value for key, value in os.environ.items() if key not in _CLIENT_SETTINGS}
    words = [program, "-i", str(number), "-l", place.address, "-p", str(place.port)]
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


def _put(profile: str, output: Path | None) -> None:
    if output is None:
        print(profile)
        return
    part = output.with_name(f"{output.name}.part")
    try:
        part.write_text(f"{profile}\n", encoding="utf-8")
        part.replace(output)
    except OSError as error:
        raise dds_profiles.NetworkError(
            f"{output}: {error.strerror}: expected a writable place"
        ) from None
    print(f"{output}: give it to --network, or set PTNSBC_NETWORK to it", file=sys.stderr)
