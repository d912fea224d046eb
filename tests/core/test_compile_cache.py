"""The compile cache: no fault of it ends a process, each is said in one line, and what is damaged is replaced."""

import ast
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import ptnsbc_core
from ptnsbc_core.kernel import COMPILED

if not COMPILED:
    pytest.skip("numba is absent or switched off: nothing is compiled", allow_module_level=True)

from ptnsbc_core import compile_cache
from ptnsbc_core.compile_cache import CacheFolder, kernel_sources, prune, source_digest

ROOT = Path(ptnsbc_core.__file__).resolve().parent.parent
KERNELS = 7
LAWS = """
from ptnsbc_core.kernel import inline_kernel, kernel

@inline_kernel
def half(x):
    return 0.5 * x
""" + "".join(
    f"""
@kernel
def law_{n}(x):
    return half(x) + {n}.0
"""
    for n in range(KERNELS)
)
PRINT = """
import sys
from laws import *
laws = [globals()[f"law_{n}"] for n in range(int(sys.argv[1]))]
print(*(law(3.0) for law in laws), sum(sum(law.dispatcher.stats.cache_hits.values()) for law in laws))
"""


@pytest.fixture
def laws(tmp_path: Path) -> Path:
    """A folder with a module of small kernels."""
    folder = tmp_path / "laws"
    folder.mkdir()
    (folder / "laws.py").write_text(LAWS)
    return folder


def started(laws: Path, cache: Path, before: str = "", count: int = 2) -> subprocess.Popen:
    """A process that calls kernels and prints the results, and how many kernels came from the cache."""
    return subprocess.Popen(
        [sys.executable, "-c", before + PRINT, str(count)],
        env={
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(ROOT), str(laws)]),
            "PTNSBC_CACHE_DIR": str(cache),
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(process: subprocess.Popen) -> tuple[int, list[str]]:
    """Kernels that came from the cache, and the lines on stderr; the results must be right."""
    out, error = process.communicate(timeout=120)
    assert process.returncode == 0, error
    *results, hits = out.split()
    assert [float(number) for number in results] == [1.5 + n for n in range(len(results))]
    return int(hits), error.splitlines()


def run(laws: Path, cache: Path, before: str = "", count: int = 2) -> tuple[int, list[str]]:
    return finished(started(laws, cache, before, count))


def files_of(cache: Path) -> list[Path]:
    """The files of law_0, law_1, ... in the only cache."""
    (folder,) = cache.iterdir()
    return sorted(folder.glob("laws.law_*"))


@pytest.mark.slow
def test_damaged_files_are_compiled_again_and_replaced(laws: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(laws, cache, count=KERNELS) == (0, [])
    assert run(laws, cache, count=KERNELS) == (KERNELS, [])
    truncated, empty, zeroed, garbage, flipped, sealed_garbage, other = files_of(cache)
    whole = truncated.read_bytes()
    truncated.write_bytes(whole[: len(whole) // 2])
    empty.write_bytes(b"")
    zeroed.write_bytes(bytes(zeroed.stat().st_size))
    garbage.write_bytes(bytes(range(256)) * 40)
    flipped.write_bytes(flipped.read_bytes()[:-100] + bytes(100))
    sealed_garbage.write_bytes(compile_cache._sealed(b"no pickle"))
    other.write_bytes(whole)  # a whole file of another kernel
    hits, lines = run(laws, cache, count=KERNELS)
    assert hits == 0
    (line,) = lines
    assert line.startswith(f"ptnsbc: compile cache {cache}")
    assert "is damaged" in line
    assert run(laws, cache, count=KERNELS) == (KERNELS, [])


@pytest.mark.slow
def test_two_processes_at_once_fill_one_cache(laws: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    both = [started(laws, cache) for _ in range(2)]
    assert [finished(process)[1] for process in both] == [[], []]
    assert run(laws, cache) == (2, [])
    (folder,) = cache.iterdir()
    assert not [path for path in folder.iterdir() if path.suffix != ".kernel"]


def test_a_file_in_the_place_of_the_folder(laws: Path, tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("mine")
    hits, (line,) = run(laws, blocked)
    assert hits == 0
    assert "Not a directory" in line
    assert blocked.read_text() == "mine"


def test_a_disk_that_takes_no_more(laws: Path, tmp_path: Path) -> None:
    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (2000, 2000))\n"
    hits, (line,) = run(laws, tmp_path / "cache", limit)
    assert hits == 0
    assert "cannot be written (File too large): the laws are compiled at every start" in line
    assert files_of(tmp_path / "cache") == []


@pytest.mark.slow
def test_a_read_only_cache_is_read(laws: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run(laws, cache)
    read_only = """
import errno, tempfile
def mkstemp(**_):
    raise OSError(errno.EROFS, "Read-only file system")
tempfile.mkstemp = mkstemp
"""
    assert run(laws, cache, read_only) == (2, [])
    files_of(cache)[0].unlink()
    hits, (line,) = run(laws, cache, read_only)
    assert hits == 1
    assert "cannot be written (Read-only file system)" in line


def test_a_cache_of_another_user_is_refused(laws: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run(laws, cache)
    before = {path: path.read_bytes() for path in files_of(cache)}
    other = f"import os; os.geteuid = lambda: {os.geteuid() + 1}\n"
    hits, (line,) = run(laws, cache, other)
    assert hits == 0
    assert f"user {os.geteuid()} owns {cache}" in line
    assert "set PTNSBC_CACHE_DIR to a folder of your own" in line
    assert before == {path: path.read_bytes() for path in files_of(cache)}


def test_a_file_of_another_user_is_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """In a folder that everybody can write to."""
    folder = CacheFolder(tmp_path, "cache")
    folder.write("law", b"code")
    assert folder.read("law") == b"code"
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert folder.read("law") is None
    assert f"user {os.getuid()} owns {tmp_path}" in capsys.readouterr().err


def test_a_cache_that_is_removed_is_made_anew(tmp_path: Path) -> None:
    folder = CacheFolder(tmp_path, "cache")
    folder.write("law", b"code")
    shutil.rmtree(tmp_path)
    assert folder.read("law") is None
    folder.write("law", b"code")
    assert folder.read("law") == b"code"
    assert folder.path.stat().st_mode & 0o777 == 0o700


def test_digest_changes_with_any_law_and_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources = {name: tmp_path / name.replace("/", "-") for name in ("core/a.py", "sim/b.py")}
    monkeypatch.setattr(compile_cache, "kernel_sources", lambda: sources)
    digest = compile_cache.source_digest.__wrapped__

    for path in sources.values():
        path.write_text("a = 1\n")
    before = digest()
    for path in sources.values():
        path.write_text("a = 2\n")
        assert digest() != before
        path.write_text("a = 1\n")
        assert digest() == before
    sources["core/tasks/a.py"] = sources.pop("core/a.py")
    assert digest() != before


def constants_of(path: Path) -> Iterator[tuple[str, str]]:
    """Names that the kernels of a module use and import from ptnsbc_sim, each with its module."""
    tree = ast.parse(path.read_text("utf-8"))
    imported = {
        alias.asname or alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("ptnsbc_sim")
        for alias in node.names
    }
    for function in (node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)):
        marks = {mark.id for mark in function.decorator_list if isinstance(mark, ast.Name)}
        if marks & {"kernel", "inline_kernel", "formula"}:
            body = ast.Module(function.body, [])
            used = {node.id for node in ast.walk(body) if isinstance(node, ast.Name)}
            yield from ((name, imported[name]) for name in used & set(imported))


def test_what_a_kernel_uses_stands_in_a_source_of_the_digest() -> None:
    """An edited constant in a module without kernels would not be seen."""
    counted = {name.removesuffix(".py").replace("/", ".") for name in kernel_sources()}
    found = [
        use
        for name, path in kernel_sources().items()
        if name.startswith("ptnsbc_sim")
        for use in constants_of(path)
    ]
    assert ("obstacles_at", "ptnsbc_sim.wiring") in found
    modules = {
        (name, module if module in counted else f"{module}.{name}") for name, module in found
    }
    assert [use for use in modules if use[1] not in counted] == []
    assert not any(
        name.startswith(("ptnsbc_sim/scenario/", "ptnsbc_sim/verdict/"))
        for name in kernel_sources()
    )


def test_packages_installed_apart_have_the_digest_of_those_side_by_side(tmp_path: Path) -> None:
    apart = []
    for package in ("ptnsbc_core", "ptnsbc_sim"):
        prefix = tmp_path / package / "site-packages"
        shutil.copytree(
            ROOT / package, prefix / package, ignore=shutil.ignore_patterns("__pycache__")
        )
        apart.append(str(prefix))
    code = "import ptnsbc_core.compile_cache as c; print(c.source_digest(), *c.kernel_sources().values())"
    found = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(apart)},
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()
    assert found[0] == source_digest()
    assert all(path.startswith(tuple(apart)) for path in found[1:])


def test_only_the_caches_used_last_are_kept_and_nothing_else_is_removed(tmp_path: Path) -> None:
    digests = [f"{number:016x}" for number in range(12)]
    for age, digest in enumerate(digests):
        (tmp_path / digest).mkdir()
        os.utime(tmp_path / digest, (1000 - age, 1000 - age))
    other = [tmp_path / "notes", tmp_path / "0123"]
    for path in other:
        path.mkdir()
    read = CacheFolder(tmp_path, digests[9])
    read.write("law", b"code")
    os.utime(read.path, (0, 0))
    assert CacheFolder(tmp_path, digests[9]).read("law") == b"code"  # by another checkout
    prune(tmp_path, tmp_path / digests[11])
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {*digests[:6], digests[9], digests[11], *(path.name for path in other)}
