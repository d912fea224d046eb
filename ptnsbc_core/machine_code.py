"""Kernels as machine code: values in memory as kernels take them, and laws that Python calls without their compiler.

Promise: a UAV process takes 110 MB at most. numba and LLVM alone take 100 MB, and a quarter of a second of a processor,
and a process that flies needs only what they have made. `linked` turns the object file of a kernel into an image that
holds for every address, `load` takes one from the compile cache, and an `Entry` calls it as numba's calling convention
has it: result, error, then each number on its own.
"""

from __future__ import annotations

import ctypes
import mmap
import os
import platform
import struct
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ptnsbc_core.compile_cache import LawFiles, kernel_folder

SUPPORTED = (sys.platform, platform.machine()) == ("linux", "x86_64")
"""True if `linked` knows the machine code of this computer."""

# Values in memory ----------------------------------------------------------------------------------------------------


def kind_of(value: Any) -> Any:
    """The kind of a value: what decides how it lies in memory, and which machine code takes it."""
    if isinstance(value, np.ndarray):
        return np.ndarray, value.dtype.str, value.ndim, value.flags.c_contiguous
    if isinstance(value, RecordList):
        return type(value), value.kind
    if isinstance(value, tuple):
        return (type(value), *map(kind_of, value))
    for kind, also in ((bool, np.bool_), (float, float), (int, np.int64)):
        if isinstance(value, kind | also):
            return kind
    return type(value)


def _parts(kind: Any) -> tuple[Any, ...] | None:
    """The kinds in that of a tuple; None for any other."""
    is_tuple = isinstance(kind, tuple) and issubclass(kind[0], tuple)
    return kind[1:] if is_tuple else None


@cache
def _layout(kind: Any) -> tuple[str, int]:
    """The numbers of a value in memory, as numba's models have it, by the codes of `struct`; and its alignment."""
    parts, codes, align = _parts(kind), "", 1
    if parts is None:
        code = {bool: "?", float: "d"}.get(kind, "q")
        count = 5 + 2 * kind[2] if isinstance(kind, tuple) and kind[0] is np.ndarray else 1
        return count * code, struct.calcsize("=" + code)
    for inner, step in map(_layout, parts):
        codes += f"{-struct.calcsize('=' + codes) % step}x{inner}"
        align = max(align, step)
    return f"{codes}{-struct.calcsize('=' + codes) % align}x", align


def _of_array(array: Any) -> tuple[int, ...]:
    """An array as kernels take it: count of references, owner, items, their size, data, shape, strides."""
    return 0, 0, array.size, array.itemsize, array.ctypes.data, *array.shape, *array.strides


def _flat(value: Any, kept: Callable[[Any], Any], numbers: list[Any]) -> list[Any]:
    """Append the numbers of a value for its layout; `kept` gives the array that stands for an array."""
    for part in value:
        if isinstance(part, tuple):
            _flat(part, kept, numbers)
        elif isinstance(part, np.ndarray):
            numbers += _of_array(kept(part))
        elif isinstance(part, RecordList):
            numbers.append(kept(part).address)
        else:
            numbers.append(0 if part is None else part)
    return numbers


def _read(kind: Any, numbers: Iterator[Any], arrays: Iterator[Any]) -> Any:
    """The value of the numbers in a layout."""
    parts = _parts(kind)
    if parts is not None:
        found = [_read(part, numbers, arrays) for part in parts]
        return kind[0](*found) if hasattr(kind[0], "_fields") else tuple(found)
    if not isinstance(kind, tuple):
        number = next(numbers)
        return None if kind is type(None) else number
    for _ in range(5 + 2 * kind[2] if kind[0] is np.ndarray else 1):
        next(numbers)
    return next(arrays)


class RecordList:
    """Several NamedTuples of one type, which kernels read and write in place; in Python a list of them.

    A record that is written keeps its arrays and takes the numbers.
    """

    def __init__(self, items: Sequence[Any]) -> None:
        self.example, self.kind = items[0], kind_of(items[0])
        self._arrays: list[list[Any]] = [[] for _ in items]
        self._numbers = struct.Struct("=" + _layout(self.kind)[0])
        self._block = np.zeros((len(items), self._numbers.size), dtype=np.uint8)
        for row, item in enumerate(items):
            self._write(row, item, partial(_keep, self._arrays[row]))
        self.address = self._block.ctypes.data

    def __len__(self) -> int:
        return len(self._block)

    def __getitem__(self, row: int) -> Any:
        numbers = iter(self._numbers.unpack_from(self._block[row]))
        return _read(self.kind, numbers, iter(self._arrays[row]))

    def __reduce__(self) -> Any:
        items = [self[row] for row in range(len(self))]
        return type(self), (items,)  # the addresses in the block are those of these arrays

    def __setitem__(self, row: int, item: Any) -> None:
        self._write(row, item, partial(_copy, iter(self._arrays[row])))

    def _write(self, row: int, item: Any, kept: Callable[[Any], Any]) -> None:
        self._numbers.pack_into(self._block[row].data, 0, *_flat(item, kept, []))


def _keep(arrays: list[Any], array: Any) -> Any:
    arrays.append(array)
    return array


def _copy(arrays: Iterator[Any], array: Any) -> Any:
    there = next(arrays)
    if there.shape != array.shape:
        raise ValueError(f"array of shape {array.shape}: expected {there.shape}")
    there[...] = array
    return there


class Referred(RecordList):
    """A NamedTuple that Python hands to kernels as one pointer; its fields are read as of the tuple."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self.example, name)


class Loaded(NamedTuple):
    """A kernel in memory."""

    address: int
    owner: object  # keeps it there


class Entry:
    """A kernel for arguments of the kinds with which it is made; no call looks at them.

    What an argument is in memory is found out when it is another object than in the call before.
    """

    def __init__(self, kernel: Loaded, arguments: Sequence[Any]) -> None:
        words: list[Sequence[Any]] = [_words(argument) for argument in arguments]
        ends = np.cumsum([len(part) for part in words]).tolist()
        self._places = [slice(end - len(part), end) for part, end in zip(words, ends, strict=True)]
        self._words = [word for part in words for word in part]
        self._last, self._owner = tuple(arguments), kernel.owner
        self._number, self._error = ctypes.c_double(), ctypes.c_void_p()
        self._out = ctypes.addressof(self._number), ctypes.addressof(self._error)
        self._law = _signature(tuple(map(type, self._words)))(kernel.address)

    def __deepcopy__(self, _memo: object) -> Entry:
        return self  # it knows its arguments again only as the same objects

    def __call__(self, *arguments: Any) -> float:
        """The number that the law gives, 0 where it gives none; RuntimeError where it raises."""
        words = self._words
        for place, argument, last in zip(self._places, arguments, self._last, strict=True):
            if argument is not last:
                words[place] = _words(argument)
        self._last = arguments
        if self._law(*self._out, *words):
            raise RuntimeError("a law has failed: expected inputs of the shapes that it takes")
        return self._number.value


@cache  # each is a class that ctypes makes
def _signature(words: tuple[type, ...]) -> Callable[[int], Callable[..., int]]:
    """How a kernel is called: where its number and its error go, and its words."""
    kinds = [ctypes.c_double if issubclass(word, float) else ctypes.c_int64 for word in words]
    return ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p, *kinds)


def _words(argument: Any) -> Sequence[float]:
    """The words by which a kernel takes an argument."""
    return _flat((argument,), lambda array: array, [])


# Machine code --------------------------------------------------------------------------------------------------------


class MachineCode(NamedTuple):
    """A kernel that can be written to any place in memory."""

    image: bytes
    entry: int  # offset of the function
    places: tuple[tuple[int, str, int], ...]
    """Offsets of addresses: of a function of the C library or, without a name, of the image, and how far behind it."""


_FILE = struct.Struct("<40xQ10xHH2x")  # of ELF
_SECTION = np.dtype("u4,u4,u8,u8,u8,u8,u4,u4,u8,u8")
_SYMBOL, _RELOCATION = np.dtype("u4,u1,u1,u2,u8,u8"), np.dtype("u8,u4,u4,i8")
_PROGRAM, _SYMBOLS, _RELOCATIONS = 1, 2, 4  # types of sections
_WRITTEN, _IN_MEMORY = 1, 2  # flags of sections
_ELSEWHERE, _COMMON = 0, 0xFFF2  # in the place of a section's number
_ADDRESS = 1  # R_X86_64_64


def linked(file: bytes, function: str) -> MachineCode:
    """The kernel of an object file in ELF.

    Raises:
        ValueError: it contains what a kernel has no need for, such as variables, or addresses of another form.
    """
    first, size, count = _FILE.unpack_from(file)
    sections = _table(file, _SECTION, first, size * count)
    image, starts, places = bytearray(), dict[int, int](), []
    for number, (_, kind, flags, _, start, size, *_, align, _) in enumerate(sections):
        if kind == _PROGRAM and flags & _IN_MEMORY and size:
            if flags & _WRITTEN:
                raise ValueError("a variable")
            image += bytes(-len(image) % align)
            starts[number] = len(image)
            image += file[start : start + size]
    image += bytes(8 - len(image) % 8)
    starts[_COMMON] = len(image)  # variables of numba, which only Python writes
    image += bytes(8)
    symbols = _symbols(file, sections, starts)
    for _, kind, _, _, start, size, _, of, *_ in sections:
        found = _table(file, _RELOCATION, start, size) if kind == _RELOCATIONS else ()
        for offset, form, symbol, behind in found if of in starts else ():
            if form != _ADDRESS:
                raise ValueError(f"an address of form {form}")
            name, value = symbols[symbol]
            at = starts[of] + offset
            places.append((at, name, behind) if value is None else (at, "", value + behind))
    return MachineCode(bytes(image), dict(symbols)[function] or 0, tuple(places))


def _table(file: bytes, kind: np.dtype[Any], start: int, size: int) -> list[Any]:
    return list(np.frombuffer(file, kind, size // kind.itemsize, start).tolist())


def _symbols(
    file: bytes, sections: Sequence[Any], starts: dict[int, int]
) -> list[tuple[str, int | None]]:
    """Names, with offsets in the image; None for a function of a library."""
    (_, _, _, _, start, size, names, *_) = next(one for one in sections if one[1] == _SYMBOLS)
    found = list[tuple[str, int | None]]()
    for title, _, _, section, value, _ in _table(file, _SYMBOL, start, size):
        at = starts.get(section, 0) + (0 if section == _COMMON else value)
        name_at = sections[names][4] + title
        name = file[name_at : file.index(0, name_at)].decode()
        found.append((name, None if section == _ELSEWHERE else at))
    return found


def in_memory(code: MachineCode) -> Loaded:
    """Bring a kernel into memory; OSError or AttributeError where the system does not have what it needs."""
    descriptor = os.memfd_create("ptnsbc")
    try:
        os.ftruncate(descriptor, len(code.image))
        # written through the file: no page may be written and executed
        pages = mmap.mmap(descriptor, len(code.image), prot=mmap.PROT_READ | mmap.PROT_EXEC)
        owner = np.frombuffer(pages, np.uint8)
        image, library = bytearray(code.image), ctypes.CDLL(None)
        start = {"": owner.ctypes.data}
        for at, name, behind in code.places:
            if name not in start:
                start[name] = ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0
            struct.pack_into("<Q", image, at, start[name] + behind)
        os.pwrite(descriptor, image, 0)
    finally:
        os.close(descriptor)
    return Loaded(start[""] + code.entry, owner)


@cache
def _processor() -> tuple[str, ...]:
    """What the kernel says of the processors: code for one may end the process on another."""
    told = ("vendor_id", "cpu family", "model", "stepping", "flags")
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return tuple(sorted({line for line in lines if line.startswith(told)}))


def load(law: Callable[..., Any], kinds: Any) -> Loaded | None:
    """The kernel of a law for arguments of these kinds from the compile cache, or None."""
    if not SUPPORTED:
        return None
    files = LawFiles(law, kernel_folder(), "code")
    return files.load((_processor(), str(kinds)), lambda parts: in_memory(MachineCode(*parts)))


def store(law: Callable[..., Any], kinds: Any, code: MachineCode) -> None:
    """Keep a kernel for `load`."""
    LawFiles(law, kernel_folder(), "code").save((_processor(), str(kinds)), tuple(code))
