"""`ptnsbc network`: a fleet on several computers: discovery, key, single processes."""

from __future__ import annotations

import os
import shutil
import sys
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from ptnsbc_nodes.runtime import dds_profiles
from ptnsbc_tools import console, ros
from ptnsbc_tools.options import (
    argument,
    group,
    option,
)

_OutputOption = Annotated[
    Path | None, option("--output -o FILE", "Write into this file and not to stdout.")
]
network = group("A fleet on several computers: profiles for --network, key, processes.")


@network.command(
    # All words after the name of a process are its own, --help too.
    context_settings={
        "ignore_unknown_options": True,
        "allow_extra_args": True,
        "allow_interspersed_args": False,
    }
)
def node(
    context: typer.Context,
    name: Annotated[
        Literal["uav", "sim", "recorder", "bridge", "coordinator"],
        argument("NAME", "The process; its own options and those of ROS follow."),
    ],
) -> None:
    """Run one process of a flight, for debugging or for a launcher of your own.

    `ptnsbc network node uav --help` lists its options. `ros2 run ptnsbc_nodes uav` is the same.
    """
    from ptnsbc_nodes.fleet.child_process import EXECUTABLES

    modules = {executable: module for module, executable in EXECUTABLES.items()}
    with ros.required():
        module = import_module(modules[name])
    raise typer.Exit(module.main(context.args))


@network.command()
def key(
    file: Annotated[
        Path | None,
        argument(
            "[FILE]",
            "Where to write it. Default: PTNSBC_FLEET_KEY, or ptnsbc/fleet.key in the folder for settings.",
        ),
    ] = None,
) -> None:
    """Write a new key for `security: signed`; copy it to every computer of the fleet."""
    with ros.required():
        from ptnsbc_nodes.comm.seal import key_file, new_key
    path = file or key_file()
    new_key(path)
    console.say(f"key: {path}")


_SERVER = "fast-discovery-server"


@network.command()
def peers(
    hosts: Annotated[
        list[str] | None, argument("HOST...", "IPv4 address or name of each computer.")
    ] = None,
    hosts_file: Annotated[
        Path | None, option("--hosts FILE", "File with one HOST per line; # begins a comment.")
    ] = None,
    processes: Annotated[
        int, option("--processes", "Processes to look for on each computer, viewers included.")
    ] = dds_profiles.PROCESSES,
    output: _OutputOption = None,
) -> None:
    """Write a profile that names every computer: no server, no multicast. All computers use the same file."""
    listed = [] if hosts_file is None else _hosts(hosts_file)
    _write_profile(dds_profiles.static_peers([*(hosts or ()), *listed], processes), output)


@network.command()
def server(
    addresses: Annotated[
        list[str], argument("ADDRESS[:PORT]...", "Address of each discovery server.")
    ],
    everything: Annotated[
        bool, option("--everything", "Discover all topics, for `ros2 topic list` and viewers.")
    ] = False,
    output: _OutputOption = None,
) -> None:
    """Write a profile for a discovery server: few packets, and computers may join and leave."""
    servers = [dds_profiles.server(address) for address in addresses]
    _write_profile(dds_profiles.discovery_client(servers, everything=everything), output)


@network.command()
def serve(
    address: Annotated[str, argument("ADDRESS[:PORT]", "Address of this host on which to listen.")],
    number: Annotated[int, option("--id", "Its number in the list of servers.", 0, 255)] = 0,
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
    ours = ("ROS_DISCOVERY_SERVER", *environment.PROFILES)
    settings = {key: value for key, value in os.environ.items() if key not in ours}
    words = [program, "-i", str(number), "-l", at.address, "-p", str(at.port)]
    os.execve(program, words, settings)


def _hosts(file: Path) -> list[str]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise dds_profiles.NetworkError(
            f"{file}: {getattr(error, 'strerror', error)}: expected a file with one host per line"
        ) from None
    return [host for line in lines if (host := line.partition("#")[0].strip())]


def _write_profile(profile: str, output: Path | None) -> None:
    if output is None:
        typer.echo(profile)
        return
    from ptnsbc_io.files import replacing

    with replacing(output) as part:
        part.write_text(f"{profile}\n", encoding="utf-8")
    console.say(f"{output}: give it to --network, or set PTNSBC_NETWORK to it")
