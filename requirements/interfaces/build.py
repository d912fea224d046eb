"""Message packages beside the wheels of ROS, made by the generators and libraries that come in these wheels.

    .venv/bin/python requirements/interfaces/build.py [--wheels DIR] PACKAGE...

Each PACKAGE is a folder with a package.xml and files in msg/, srv/ or action/, such as a vendor of vehicles keeps
them for colcon. One that needs another stands after it. It is generated, compiled by g++ and
installed beside the others: Python into site-packages, libraries into lib, definitions and hashes into share. All is
built elsewhere first, so that a package is there whole or not at all. With --wheels it becomes a wheel in DIR, for the
Python that runs this.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from functools import cache, partial
from io import StringIO
from pathlib import Path

PREFIX = Path(sys.prefix)
SHARE, LIB, INCLUDE = PREFIX / "share", PREFIX / "lib", PREFIX / "include"
SITE = Path(sysconfig.get_path("purelib"))

_SETUP = """\
from pathlib import Path

from setuptools import Distribution, setup


class Compiled(Distribution):
    def has_ext_modules(self):
        return True


files = sorted(path for top in ("lib", "share") for path in Path(top).rglob("*") if path.is_file())
setup(
    name={name!r},
    version={version!r},
    license="Apache-2.0",
    packages={packages!r},
    package_dir={{"": "site"}},
    package_data={{"": ["*.so"]}},
    data_files=[(str(path.parent), [str(path)]) for path in files],
    distclass=Compiled,
)
"""

_C, _FASTRTPS, _INTROSPECTION = (
    "rosidl_generator_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_introspection_c",  # rmw_fastrtps registers a type by it
)
_TYPE_SUPPORT, _PYTHON = "rosidl_typesupport_c", "rosidl_generator_py"
_DEPENDENCIES = ("depend", "build_depend", "exec_depend", "build_export_depend")
# Few packages name what the generators need of every service and action.
_OF_KINDS = {"srv": ["service_msgs"], "action": ["action_msgs", "service_msgs"]}
_JOBS = min(4, os.cpu_count() or 1)


class BuildError(Exception):
    """A package that cannot be built."""


def depended_on(package: Path) -> list[str]:
    """Names of the message packages that a package needs, also indirectly."""
    found: list[str] = []

    def look(folder: Path) -> None:
        root = ElementTree.parse(folder / "package.xml").getroot()
        names = [entry.text or "" for tag in _DEPENDENCIES for entry in root.findall(tag)]
        for kind, implied in _OF_KINDS.items():
            names += implied if any(folder.glob(f"{kind}/*.{kind}")) else []
        for name in names:
            if name not in found and any((SHARE / name).glob("*/*.idl")):
                found.append(name)
                look(SHARE / name)

    look(package)
    return found


class Package:
    """One package on its way from definitions to libraries."""

    def __init__(self, source: Path, work: Path) -> None:
        self.source = source
        self.name = ElementTree.parse(source / "package.xml").findtext("name", source.name)
        self.work, self.out = work, work / "out"
        self.needs = depended_on(source)
        self.definitions = sorted(
            path for kind in ("msg", "srv", "action") for path in source.glob(f"{kind}/*.{kind}")
        )
        self.idl = [
            f"{path.parent.name}/{path.stem}.idl" for path in self.definitions
        ]  # relative, as the generators name them

    def generate(self) -> None:
        """All C, C++ and Python sources."""
        from rosidl_adapter import convert_to_idl
        from rosidl_cli.command.helpers import generate_visibility_control_file
        from rosidl_generator_c import generate_c
        from rosidl_generator_py import generate_py
        from rosidl_generator_type_description import generate_type_hash
        from rosidl_parser import parser
        from rosidl_typesupport_c import generate_c as generate_type_support
        from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
        from rosidl_typesupport_introspection_c import generate_c as generate_introspection

        # Each of the six generators parses all definitions, which is a quarter of their time.
        parser.get_ast_from_idl_string = cache(parser.get_ast_from_idl_string)
        for path in self.definitions:
            relative = path.relative_to(self.source)
            convert_to_idl(self.source, self.name, relative, self.work / "idl")
        generate_type_hash(self._arguments("rosidl_generator_type_description", _C))
        generate_c(self._arguments(_C))
        generate_typesupport_fastrtps_c(self._arguments(_FASTRTPS))
        generate_introspection(self._arguments(_INTROSPECTION))
        generate_type_support(self._arguments(_TYPE_SUPPORT), [_FASTRTPS, _INTROSPECTION])
        generate_py(self._arguments(_PYTHON), [_TYPE_SUPPORT])
        for generator in (_C, _FASTRTPS, _INTROSPECTION):
            name = f"{generator}__visibility_control.h"
            generate_visibility_control_file(
                package_name=self.name,
                template_path=SHARE / generator / "resource" / f"{name}.in",
                output_path=self._made(generator) / "msg" / name,
            )

    def _made(self, generator: str) -> Path:
        return self.work / generator / self.name

    def _arguments(self, generator: str, templates: str = "") -> str:
        """The file with a generator's arguments."""
        made = self._made(generator)
        made.mkdir(parents=True, exist_ok=True)
        described = self._made("rosidl_generator_type_description")
        arguments = {
            "package_name": self.name,
            "output_dir": str(made),
            "template_dir": str(SHARE / (templates or generator) / "resource"),
            "idl_tuples": [f"{self.work / 'idl'}:{name}" for name in self.idl],
            "ros_interface_dependencies": [
                f"{name}:{path}" for name in self.needs for path in (SHARE / name).glob("*/*.idl")
            ],
            "target_dependencies": [],
            "include_paths": [f"{name}:{SHARE / name}" for name in self.needs],
            "type_description_tuples": [
                f"{name}:{described / name.removesuffix('.idl')}.json" for name in self.idl
            ],
        }
        path = self.work / f"{generator}.json"
        path.write_text(json.dumps(arguments), encoding="utf-8")
        return str(path)

    def compile(self) -> None:
        """The libraries and the modules of Python."""
        (self.out / "lib").mkdir(parents=True)
        site = self.out / "site" / self.name
        shutil.copytree(self._made(_PYTHON), site, ignore=shutil.ignore_patterns("*.c"))
        (site / "__init__.py").touch()
        own = f"{self.name}__{{}}".format
        self._library(_C, "*/detail/*.c", [_TYPE_SUPPORT, "rosidl_runtime_c", "rcutils"], [_C])
        self._library(
            _FASTRTPS,
            "*/detail/*.cpp",
            [own(_C), _FASTRTPS, "rosidl_typesupport_fastrtps_cpp", "fastcdr", "rmw"],
            [_FASTRTPS, _C],
        )
        self._library(
            _INTROSPECTION,
            "*/detail/*.c",
            [own(_C), _INTROSPECTION, "rosidl_runtime_c"],
            [_INTROSPECTION, _C],
        )
        self._library(
            _TYPE_SUPPORT,
            "*/*.cpp",
            [own(_C), own(_FASTRTPS), own(_INTROSPECTION), _TYPE_SUPPORT],
            [_TYPE_SUPPORT],
        )
        self._library(_PYTHON, "*/*_s.c", [own(_C), own(_TYPE_SUPPORT)], [_PYTHON, _C])
        sources = [self._made(_PYTHON) / f"_{self.name}_s.ep.{_TYPE_SUPPORT}.c"]
        target = site / f"{self.name}_s__{_TYPE_SUPPORT}{sysconfig.get_config_var('EXT_SUFFIX')}"
        self._link(target, sources, [own(_PYTHON), own(_TYPE_SUPPORT), own(_C)])

    def _library(
        self, kind: str, sources: str, libraries: Iterable[str], of_needs: Iterable[str] = ()
    ) -> None:
        inherited = (f"{name}__{part}" for part in of_needs for name in self.needs)
        there = [name for name in inherited if (LIB / f"lib{name}.so").exists()]
        target = self.out / "lib" / f"lib{self.name}__{kind}.so"
        self._link(target, sorted(self._made(kind).glob(sources)), [*libraries, *there])

    def _link(self, target: Path, sources: list[Path], libraries: Iterable[str]) -> None:
        import numpy

        generated = (self.work / kind for kind in (_C, _FASTRTPS, _INTROSPECTION))
        folders = [path for path in INCLUDE.iterdir() if path.is_dir()]
        python = [sysconfig.get_path("include"), numpy.get_include()]
        includes = [f"-I{path}" for path in (*generated, *folders, INCLUDE, *python)]

        def compiled(source: Path) -> str:
            target = self.work / f"{'_'.join(source.relative_to(self.work).parts)}.o"
            standard = ["-std=c++17"] if source.suffix == ".cpp" else ["-x", "c", "-std=gnu11"]
            _run(
                ["g++", "-O1", "-fPIC", "-c", *includes, *standard, str(source), "-o", str(target)]
            )
            return str(target)

        if sources[0].suffix == ".cpp":  # one file of all: g++ reads their headers once
            whole = self.work / f"{target.name}.cpp"
            whole.write_text("".join(f'#include "{path}"\n' for path in sources), encoding="utf-8")
            sources = [whole]
        with ThreadPoolExecutor(_JOBS) as pool:
            objects = list(pool.map(compiled, sources))
        found = [f"-L{self.out / 'lib'}", f"-L{LIB}", *(f"-l{name}" for name in libraries)]
        paths = [f"-Wl,-rpath,{path}" for path in ("$ORIGIN", "$ORIGIN/../../..")]
        _run(["g++", "-shared", "-o", str(target), *objects, *found, *paths])

    def install(self, share: Path = SHARE, lib: Path = LIB, site: Path = SITE) -> None:
        """By default beside the packages of the wheels; what Python imports comes last."""
        for kind in {path.parent.name for path in self.definitions}:
            (share / self.name / kind).mkdir(parents=True, exist_ok=True)
        described = self._made("rosidl_generator_type_description")
        own = share / self.name
        for path, idl in zip(self.definitions, self.idl, strict=True):
            shutil.copy(path, own / path.relative_to(self.source))
            shutil.copy(self.work / "idl" / idl, own / idl)
            shutil.copy(described / f"{idl.removesuffix('.idl')}.json", own / Path(idl).parent)
        shutil.copy(self.source / "package.xml", own)
        index = share / "ament_index" / "resource_index"
        listed = [str(path.relative_to(self.source)) for path in self.definitions]
        for resource, text in (("packages", ""), ("rosidl_interfaces", "\n".join(listed))):
            (index / resource).mkdir(parents=True, exist_ok=True)
            (index / resource / self.name).write_text(text, encoding="utf-8")
        made = {path.name for path in (self.out / "lib").iterdir()}
        for path in lib.glob(f"lib{self.name}__*.so"):
            if path.name not in made:  # of an older build
                path.unlink()
        for name in made:
            _replace(self.out / "lib" / name, lib / name)
        _replace(self.out / "site" / self.name, site / self.name)

    def make_wheel(self, folder: Path) -> None:
        """A wheel that installs the same files."""
        tree = self.work / "wheel"
        for name in ("share", "lib", "site"):
            (tree / name).mkdir(parents=True)
        self.install(tree / "share", tree / "lib", tree / "site")
        top = tree / "site"
        packages = [str(one.parent.relative_to(top)) for one in top.rglob("__init__.py")]
        version = ElementTree.parse(self.source / "package.xml").findtext("version")
        names = sorted(name.replace("/", ".") for name in packages)
        text = _SETUP.format(name=self.name, version=version, packages=names)
        (tree / "setup.py").write_text(text, encoding="utf-8")
        pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
        options = ["--no-deps", "--no-build-isolation", "--no-index", "-w", str(folder)]
        _run([*pip, *options, str(tree)])


def _replace(made: Path, target: Path) -> None:
    """A file or folder in the place of an older one."""
    beside = target.with_name(f".{target.name}.part")
    for old in (beside, *([target] if made.is_dir() else [])):
        if old.is_dir():
            shutil.rmtree(old)
    (shutil.copytree if made.is_dir() else shutil.copy)(made, beside)
    beside.rename(target)


def _run(command: list[str]) -> None:
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    except OSError as error:
        raise BuildError(f"{command[0]}: {error.strerror}") from None
    if done.returncode:
        raise BuildError(f"{' '.join(command)}\n{done.stderr[-4000:]}")


def build(source: Path, wheels: Path | None = None) -> None:
    """Generate, compile and install one package, or make a wheel of it in the folder `wheels`.

    Raises:
        BuildError: there is no package, or the compiler is missing or refuses.
    """
    if not (source / "package.xml").is_file():
        raise BuildError("no package.xml")
    with tempfile.TemporaryDirectory() as folder:
        package = Package(source, Path(folder))
        steps: list[Callable[[], None]] = [package.generate, package.compile]
        steps.append(package.install if wheels is None else partial(package.make_wheel, wheels))
        with redirect_stdout(StringIO()):  # the generators tell every file
            for step in steps:
                step()


def main() -> int:
    """The command."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--wheels", type=Path, metavar="DIR", help="make wheels in DIR instead")
    parser.add_argument("package", type=Path, nargs="+")
    given = parser.parse_args()
    for path in given.package:
        try:
            build(path.resolve(), given.wheels)
        except BuildError as error:
            print(f"interfaces: {path}: {error}", file=sys.stderr)
            return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
