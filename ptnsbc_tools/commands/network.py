"""`ptnsbc network`: a fleet on several computers: discovery, key, single processes."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import typer

from ptnsbc_nodes.runtime import dds_profiles
from ptnsbc_tools import console, ros
from ptnsbc_tools.options import argument, group, option

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
