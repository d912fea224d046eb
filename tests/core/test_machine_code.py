"""Kernels in memory without numba: the same bits, from a cache of which no fault ends a process."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import ptnsbc_core
from ptnsbc_core import machine_code
from ptnsbc_core.compile_cache import CacheFolder
from ptnsbc_core.kernel import prepared
from ptnsbc_core.kinematics import body_rates, move_to_present
from ptnsbc_core.machine_code import (
    SUPPORTED,
    Entry,
    MachineCode,
    RecordList,
    in_memory,
    linked,
    load,
    store,
)

if not SUPPORTED:
    pytest.skip("the machine code of this computer is not linked here", allow_module_level=True)

ROOT = Path(ptnsbc_core.__file__).resolve().parent.parent
NOTHING, FAULT = bytes.fromhex("31c0c3"), bytes.fromhex("b801000000c3")  # x86: return 0, return 1
LAW, KINDS = body_rates, ("kinds",)  # any law, and the kinds of its arguments


def test_an_entry_gives_the_bits_of_numba() -> None:
    odometry = np.linspace(-1.0, 2.0, 13)
    expected = odometry.copy()
    move_to_present(expected, 0.125)
    law = prepared(move_to_present, odometry, 0.0)
    other = odometry.copy()
    law(other, 0.125)
    assert other.tobytes() == expected.tobytes()
    for _ in range(2):  # the arguments of the call before count no more
        law(odometry, 0.125)
    move_to_present(expected, 0.125)
    assert odometry.tobytes() == expected.tobytes()


@pytest.mark.compiles
def test_a_process_with_a_warm_cache_steps_without_numba() -> None:
    code = """
import sys
from ptnsbc_nodes.runtime.warmup import load_agent
from ptnsbc_sim.scenario import load_scenario
load_agent(load_scenario("mission_6"), 2)
print(sorted({"numba", "llvmlite"} & set(sys.modules)))
"""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    outputs = [
        subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    assert outputs[1] == "[]\n"


class Mixed(NamedTuple):
    known: bool
    place: tuple[float, tuple[bool, int]]
    nothing: None
    table: np.ndarray


def test_a_record_reads_as_it_was_written() -> None:
    item = Mixed(True, (-0.0, (False, 2**40)), None, np.arange(6.0).reshape(2, 3))
    records = RecordList([item, item._replace(known=False, table=np.ones((2, 3)))])
    assert [one.known for one in records] == [True, False]
    assert str(records[0][:3]) == str(item[:3])
    records[1] = item
    assert str(records[1]) == str(item)
    assert records[1].table is not item.table
    with pytest.raises(ValueError, match=r"array of shape \(3,\): expected \(2, 3\)"):
        records[0] = item._replace(table=np.ones(3))


def test_a_law_that_raises_is_a_python_error() -> None:
    with pytest.raises(RuntimeError, match="a law has failed"):
        Entry(in_memory(MachineCode(FAULT, 0, ())), (1.0,))(2.0)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CacheFolder:
    folder = CacheFolder(tmp_path, "digest")
    monkeypatch.setattr(machine_code, "kernel_folder", lambda: folder)
    return folder


@pytest.mark.parametrize(
    "damage",
    [
        lambda content: content[:-20],
        lambda content: b"",
        lambda content: content[:-20] + bytes(20),
    ],
)
def test_a_damaged_file_is_no_kernel(
    damage: Callable[[bytes], bytes], folder: CacheFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    store(LAW, KINDS, MachineCode(NOTHING, 0, ()))
    assert load(LAW, KINDS) is not None
    (file,) = folder.path.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert load(LAW, KINDS) is None
    assert "is damaged" in capsys.readouterr().err


def test_a_kernel_with_a_function_that_nobody_has_is_no_kernel(
    folder: CacheFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    store(LAW, KINDS, MachineCode(bytes(16), 0, ((8, "no_such_function", 0),)))
    assert load(LAW, KINDS) is None
    assert "is damaged" in capsys.readouterr().err


def test_the_code_for_another_processor_is_not_read(
    folder: CacheFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    store(LAW, KINDS, MachineCode(NOTHING, 0, ()))
    monkeypatch.setattr(machine_code, "_processor", lambda: "another")
    assert load(LAW, KINDS) is None


SOURCE = """
{kind}
declare double @sin(double)
@table = internal constant [2 x double] [double 1.0, double 2.5]
define i32 @law(ptr %out, ptr %error, double %x, i64 %k) {{
  %place = getelementptr [2 x double], ptr @table, i64 0, i64 %k
  %factor = load double, ptr %place
  %sine = call double @sin(double %x)
  %y = fmul double %factor, %sine
  store double %y, ptr %out
  ret i32 0
}}
"""


def compiled(before: str = "", model: str = "large") -> bytes:
    """The object file of a small law."""
    binding = pytest.importorskip("llvmlite.binding")
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    machine = binding.Target.from_default_triple().create_target_machine(
        codemodel=model, reloc="static"
    )
    return machine.emit_object(binding.parse_assembly(SOURCE.format(kind=before)))


def test_constants_and_functions_are_found_wherever_the_kernel_lies() -> None:
    code = linked(compiled(), "law")
    laws = [Entry(in_memory(code), (0.0, 0)) for _ in range(2)]
    assert [law(0.5, k) for law in laws for k in (0, 1)] == 2 * [np.sin(0.5), 2.5 * np.sin(0.5)]


def test_code_of_another_form_is_refused() -> None:
    with pytest.raises(ValueError, match="an address of form"):
        linked(compiled(model="small"), "law")
    with pytest.raises(ValueError, match="a variable"):
        linked(compiled("@count = global i64 5"), "law")
