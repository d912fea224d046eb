"""A process that has loaded everything gives memory back, and nothing in it changes."""

import ctypes
import mmap
import re
import subprocess
import sys
from pathlib import Path

import pytest

from ptnsbc_nodes.runtime import memory
from ptnsbc_nodes.runtime.memory import Mapping, mappings, release

SIZE = 64 * mmap.PAGESIZE

pytestmark = pytest.mark.skipif(
    not hasattr(mmap, "MADV_DONTNEED") or not any(mappings()), reason="the kernel does not tell"
)


of_gnu = pytest.mark.skipif(
    not hasattr(ctypes.CDLL(None), "malloc_info"),
    reason="heaps are set and shown by functions that only the C library of GNU has",
)


class Mapped:
    """A file in memory as a library is: private, and read only."""

    def __init__(self, path):
        path.write_bytes(bytes(range(1, 256)) * (SIZE // 255) + b"\1" * (SIZE % 255))
        self.content = path.read_bytes()
        self._name = path.name
        with path.open("rb") as file:
            self._memory = mmap.mmap(
                file.fileno(), SIZE, mmap.MAP_PRIVATE, mmap.PROT_READ | mmap.PROT_WRITE
            )
        self._view = (ctypes.c_char * SIZE).from_buffer(self._memory)
        self.protect(mmap.PROT_READ)

    def protect(self, protection):
        address = ctypes.c_void_p(ctypes.addressof(self._view))
        assert ctypes.CDLL(None).mprotect(address, ctypes.c_size_t(SIZE), protection) == 0

    def read(self):
        return bytes(self._memory)

    def write(self, at, data):
        self.protect(mmap.PROT_READ | mmap.PROT_WRITE)
        self._memory[at : at + len(data)] = data
        self.protect(mmap.PROT_READ)

    def release(self):
        release(re.compile(re.escape(self._name)))

    def resident_kb(self):
        """The resident memory that the kernel counts for all parts of the mapping."""
        inside, found = False, 0
        for line in Path("/proc/self/smaps").read_text().splitlines():
            if re.match(r"[0-9a-f]+-", line):
                inside = line.endswith(self._name)
            elif inside and line.startswith("Rss:"):
                found += int(line.split()[1])
        return found


@pytest.fixture
def mapped(tmp_path):
    return Mapped(tmp_path / "library.so")


def test_unchanged_pages_go_and_come_back_from_the_file(mapped):
    assert mapped.read() == mapped.content
    assert mapped.resident_kb() == SIZE // 1024
    mapped.release()
    assert mapped.resident_kb() == 0
    assert mapped.read() == mapped.content


def test_a_mapping_with_a_written_page_keeps_all_of_it(mapped):
    """A library's relocated tables are read only once it is loaded, and differ from its file."""
    mapped.write(5 * mmap.PAGESIZE, b"relocated")
    before = mapped.read()
    mapped.release()
    assert mapped.read() == before != mapped.content
    assert mapped.resident_kb() == SIZE // 1024


def test_other_files_stay(mapped):
    assert mapped.read() == mapped.content
    release(re.compile("another"))
    assert mapped.resident_kb() == SIZE // 1024


def test_pages_that_can_be_written_or_are_shared_are_never_clean():
    clean = Mapping(0, 4096, "r-xp", "/lib/one.so", 0)
    assert clean.is_clean
    for permissions in ("rw-p", "rwxp", "r--s", "---p"):
        assert not clean._replace(permissions=permissions).is_clean
    assert not clean._replace(written_kb=4).is_clean


def test_pages_that_were_written_and_moved_out_of_memory_count_as_written(tmp_path, monkeypatch):
    told = "7f00-7f10 r--p 00000000 fe:00 12 /lib/my lib.so\nAnonymous: 0 kB\nSwap: 4 kB\nVmFlags: rd\n"
    (tmp_path / "smaps").write_text(told)
    monkeypatch.setattr(memory, "_MAPPINGS", tmp_path / "smaps")
    assert list(mappings()) == [Mapping(0x7F00, 0x7F10, "r--p", "/lib/my lib.so", 4)]


def test_a_kernel_that_does_not_tell_is_no_fault(tmp_path, monkeypatch):
    monkeypatch.setattr(memory, "_MAPPINGS", tmp_path / "none")
    memory.settle()


def test_laws_are_compiled_and_computed_after_the_compiler_was_let_go():
    numba = pytest.importorskip("numba")
    double = numba.njit(lambda x: 2.0 * x)
    assert double(1.5) == 3.0
    memory.settle()
    compiler = [one for one in mappings() if "llvm" in one.file.lower() and one.is_clean]
    assert compiler
    assert double(2.5) == 5.0
    assert double(2) == 4.0  # compiles again, for another type


HEAPS = """
import ctypes, os, sys, threading
from ptnsbc_nodes.runtime import memory
library = ctypes.CDLL(None)
library.malloc.restype, library.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
if sys.argv[1] == "shared":
    memory.keep_heap()
all_run = threading.Barrier(4)
def take():
    library.malloc(5000)
    all_run.wait()
threads = [threading.Thread(target=take) for _ in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
library.fdopen.restype = ctypes.c_void_p
file = os.open(sys.argv[2], os.O_RDWR | os.O_CREAT)
stream = ctypes.c_void_p(library.fdopen(file, b"w"))
library.malloc_info(0, stream)
library.fflush(stream)
"""


def heaps(tmp_path, kind):
    """The number of heaps of a process whose four threads take memory at the same time."""
    file = tmp_path / kind
    subprocess.run([sys.executable, "-c", HEAPS, kind, str(file)], check=True)
    return len(re.findall("<heap nr=", file.read_text()))


@of_gnu
def test_threads_share_one_heap(tmp_path):
    assert heaps(tmp_path, "own") > 1
    assert heaps(tmp_path, "shared") == 1


FAULTS = """
import ctypes, resource, sys
from ptnsbc_nodes.runtime import memory
library = ctypes.CDLL(None)
library.malloc.restype, library.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
library.free.argtypes = [ctypes.c_void_p]
if sys.argv[1] == "kept":
    memory.keep_heap()
def backlog():
    blocks = [library.malloc(size) for size in (400_000, *[50_000] * 40)]
    for block in blocks:
        ctypes.memset(block, 1, 50_000)
    for block in blocks:
        library.free(block)
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
backlog()
before = faults()
for _ in range(20):
    backlog()
print(faults() - before)
"""


@of_gnu
def test_a_backlog_takes_the_pages_of_the_one_before():
    """One of 2 MB has 500 pages."""
    command = [sys.executable, "-c", FAULTS]
    kept, given_back = (
        int(subprocess.run([*command, kind], check=True, capture_output=True).stdout)
        for kind in ("kept", "given back")
    )
    assert kept < 100
    assert given_back > 20 * 400
