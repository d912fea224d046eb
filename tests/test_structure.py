"""The structure of the packages: which module imports which, how classes, folders and test files are named.

The import graph is read from the source. An import inside a function or under TYPE_CHECKING counts as well.
The lists of exceptions are exact: an entry that is needed no longer fails its test, so remove it.
"""

from __future__ import annotations

import ast
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
PUBLIC = {"_asdict", "_fields", "_make", "_replace", "_exit"}  # documented, in spite of the name

LAYERS = (
    "ptnsbc_core",
    "ptnsbc_io",
    "ptnsbc_sim",
    "ptnsbc_autopilot",
    "ptnsbc_nodes",
    "ptnsbc_tools",
    "ptnsbc",
    "paper",
)
"""From bottom to top: a package imports itself and those before it."""

PRODUCT = ("ptnsbc_core", "ptnsbc_io", "ptnsbc_sim", "ptnsbc_nodes", "ptnsbc_tools", "ptnsbc")
"""What `import ptnsbc` and the commands need."""

# What goes in takes something out.
MOST_LINES, MOST_MODULES = 42_000, 300  # of the product, without blank lines
MOST_BENCH_LINES = 2_200
LARGEST_FOLDER = 15
LARGEST_CLASS = 15  # methods
LONGEST_FUNCTION = 80  # lines
MOST_OF_A_NAME = 2  # modules of the product with one name

Arrow = tuple[str, str]

# Import circles that are left: the arrow to remove of each.
CIRCLES: set[Arrow] = set()

# Circles between the rooms of ptnsbc_nodes that are left: the arrow to remove of each.
ROOM_CIRCLES: set[Arrow] = set()

# Class names that more than one class has.
SAME_NAMES: set[str] = set()

# Modules that reach behind the edge of a library, each with the promise that needs it.
ESCAPE_HATCHES: dict[str, str] = {
    "ptnsbc_core.machine_code": "a UAV process takes 110 MB at most",
    "ptnsbc_core.compile_cache": "a damaged or foreign cache of compiled laws ends no process",
    "ptnsbc_core.compiler": "the first flight compiles in seconds",
    "ptnsbc_nodes.runtime.launcher": "a process ends with its launcher: no vehicle is left alone",
    "ptnsbc_sim.plugins.loader": "a plug-in that numba compiles finds the names of its own file",
    "ptnsbc_tools.doctor": "the state of the clock is told without a program that may be missing",
}

# Folders above LARGEST_FOLDER modules, and why.
LARGE_FOLDERS: dict[str, str] = {}

# Tests of no single module, and what they test.
TESTS_OF_MORE: dict[str, str] = {
    "tests/core/tasks/test_clearance_braking.py": "clearance.py with near_constraints.py",
    "tests/core/tasks/test_clearance_flights.py": "clearance.py with near_constraints.py and recovery.py",
    "tests/core/tasks/test_jacobians.py": "all tasks",
    "tests/io/bag/test_hostile.py": "bags that were made to do harm",
    "tests/nodes/bridge/procedure/test_procedure_in_flight.py": "procedure.py, once the vehicle flies",
    "tests/nodes/bridge/ros_vehicle/test_px4_dds.py": "examples/vehicles/px4_dds.py",
    "tests/nodes/bridge/test_fleet_comings.py": "a fleet of bridges in which UAVs come and go",
    "tests/nodes/bridge/test_fleet_mavlink.py": "a fleet of bridges",
    "tests/nodes/bridge/test_processes.py": "the processes of a bridged UAV",
    "tests/nodes/comm/test_serialize.py": "ptnsbc_io/cdr.py, with the message classes of ROS",
    "tests/nodes/fleet/test_computers.py": "a fleet on two computers",
    "tests/nodes/fleet/test_process_list.py": "child_process.py with the options that fleet.py refuses",
    "tests/nodes/uav/test_uav_graph.py": "uav_node.py: its names, namespace and time",
    "tests/nodes/uav/test_uav_status.py": "uav_node.py: what a UAV says of itself",
    "tests/autopilot/firmware/test_response.py": "how stand-ins follow velocities",
    "tests/sim/test_shipped_scenarios.py": "scenarios/",
    "tests/tools/report/test_browser.py": "report/assets/",
}

# Tests that do not stand where their module stands yet: move or rename them.
TESTS_TO_MOVE: set[str] = set()


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


SOURCES = {_module(path): path for layer in LAYERS for path in sorted((ROOT / layer).rglob("*.py"))}


@cache
def _trees() -> dict[str, ast.Module]:
    return {module: ast.parse(path.read_text()) for module, path in SOURCES.items()}


@cache
def _nodes(tree: ast.Module) -> tuple[ast.AST, ...]:
    """All nodes of a module, for all who look at them."""
    return tuple(ast.walk(tree))


def _imported(module: str, known: Mapping[str, object], tree: ast.Module) -> Iterator[str]:
    """The modules out of `known` that a module names in an import statement."""
    for node in _nodes(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in known:
                    yield alias.name
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                if name in known:
                    yield name
                elif node.module in known:
                    yield str(node.module)


@cache
def _import_graph() -> dict[str, set[str]]:
    """The modules that each module imports."""
    return {
        module: set(_imported(module, SOURCES, tree)) - {module}
        for module, tree in _trees().items()
    }


def _room(module: str) -> str:
    """`ptnsbc_nodes.bridge` of `ptnsbc_nodes.bridge.setpoint.setpoint_stream`."""
    return ".".join(module.split(".")[:2])


def _rooms(package: str) -> dict[str, set[str]]:
    rooms: dict[str, set[str]] = defaultdict(set)
    for module, imports in _import_graph().items():
        if module.startswith(f"{package}."):
            inside = {_room(name) for name in imports if name.startswith(f"{package}.")}
            rooms[_room(module)] |= inside - {_room(module)}
    return rooms


def _circle(graph: Mapping[str, set[str]]) -> list[str]:
    """One circle of arrows "a imports b", empty without any."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return list(reversed(error.args[1]))
    return []


def _check_circles(graph: Mapping[str, set[str]], exceptions: set[Arrow]) -> None:
    rest = {
        module: {name for name in imports if (module, name) not in exceptions}
        for module, imports in graph.items()
    }
    circle = _circle(rest)
    assert not circle, "import circle: " + " -> ".join(circle)
    for module, name in sorted(exceptions):
        with_it = {**rest, module: rest.get(module, set()) | {name}}
        needed = name in graph.get(module, set()) and _circle(with_it)
        assert needed, f"{module} -> {name} closes no circle any more: remove the exception"


@pytest.mark.slow
def test_no_circle_between_modules() -> None:
    _check_circles(_import_graph(), CIRCLES)


def test_no_circle_between_the_rooms_of_the_nodes() -> None:
    _check_circles(_rooms("ptnsbc_nodes"), ROOM_CIRCLES)


def test_no_package_imports_from_one_above_it() -> None:
    level = {layer: index for index, layer in enumerate(LAYERS)}
    upward = [
        f"{module} -> {name}"
        for module, imports in _import_graph().items()
        for name in sorted(imports)
        if level[name.split(".")[0]] > level[module.split(".")[0]]
    ]
    assert upward == []


def test_no_two_classes_share_a_name() -> None:
    where = defaultdict(list)
    for module, tree in _trees().items():
        for node in _nodes(tree):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(f"{module}.{node.name}")
    shared = {name: places for name, places in where.items() if len(places) > 1}
    assert set(shared) == SAME_NAMES, shared


def test_no_folder_is_crowded() -> None:
    count = Counter(
        str(path.parent.relative_to(ROOT))
        for path in SOURCES.values()
        if path.name != "__init__.py"
    )
    crowded = {folder: number for folder, number in count.items() if number > LARGEST_FOLDER}
    assert set(crowded) == set(LARGE_FOLDERS), crowded


def _lines(path: Path) -> int:
    return sum(bool(line.strip()) for line in path.read_text(encoding="utf-8").splitlines())


def test_the_product_has_a_size() -> None:
    product = [path for module, path in SOURCES.items() if module.split(".")[0] in PRODUCT]
    lines = sum(map(_lines, product))
    assert (lines <= MOST_LINES, len(product) <= MOST_MODULES) == (True, True), (
        f"{lines} lines in {len(product)} modules: expected at most {MOST_LINES} in {MOST_MODULES}; "
        "what goes in takes something out"
    )
    bench = sum(map(_lines, (ROOT / "bench").rglob("*.py")))
    assert bench <= MOST_BENCH_LINES


def test_a_class_owns_one_thing_and_a_function_is_one_thought() -> None:
    large = []
    for module, tree in _trees().items():
        for node in _nodes(tree):
            if isinstance(node, ast.ClassDef):
                methods = sum(isinstance(part, FUNCTIONS) for part in node.body)
                if methods > LARGEST_CLASS:
                    large.append(f"{module}.{node.name}: {methods} methods")
            elif isinstance(node, FUNCTIONS):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > LONGEST_FUNCTION:
                    large.append(f"{module}.{node.name}: {lines} lines")
    assert large == []


def test_a_name_of_a_module_says_which_one() -> None:
    names = Counter(
        path.name
        for module, path in SOURCES.items()
        if module.split(".")[0] in PRODUCT and path.name != "__init__.py"
    )
    assert [name for name, number in names.items() if number > MOST_OF_A_NAME] == []


def _is_own_store(node: ast.Attribute) -> bool:
    """True for `self.name = ...`: what an object stores in itself is its own, what it stores in another is not."""
    own = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
    return own and isinstance(node.ctx, ast.Store)


def _escapes(tree: ast.Module) -> Iterator[str]:
    """What reaches behind a library's edge: privates of others, ctypes, exec, another class, fake modules."""
    ours = {
        name
        for node in _nodes(tree)
        for name in (
            getattr(node, "name", None),
            node.attr if isinstance(node, ast.Attribute) and _is_own_store(node) else None,
            node.id if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) else None,
        )
        if name
    }
    for node in _nodes(tree):
        if isinstance(node, ast.Attribute):
            owned = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls")
            private = node.attr.startswith("_") and not node.attr.startswith("__")
            private = private and not owned and node.attr not in ours | PUBLIC
            if private or (node.attr == "__class__" and isinstance(node.ctx, ast.Store)):
                yield ast.unparse(node)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) in ("exec", "eval"):
            yield ast.unparse(node.func)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            source = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in source or [alias.name for alias in node.names]:
                if name == "ctypes" or any(
                    part.startswith("_") and not part.startswith("__") for part in name.split(".")
                ):
                    yield name
        elif (
            isinstance(node, ast.Subscript)
            and not isinstance(node.ctx, ast.Load)
            and ast.unparse(node.value) == "sys.modules"
        ):
            yield ast.unparse(node)


def test_we_stop_at_the_edge_of_a_library() -> None:
    escapes = {module: sorted(set(_escapes(tree))) for module, tree in _trees().items()}
    found = {module: names for module, names in escapes.items() if names}
    assert set(found) == set(ESCAPE_HATCHES), found


def _homeless_tests() -> set[str]:
    """Test files below tests/<package> without a module or package of their name at their place.

    A test of a whole package may also stand in it: tests/tools/check/test_check.py.
    """
    found = set()
    for layer in LAYERS:
        tests = ROOT / "tests" / layer.removeprefix("ptnsbc_")
        for path in tests.rglob("test_*.py"):
            folder = ROOT / layer / path.relative_to(tests).parent
            place = folder / path.stem.removeprefix("test_")
            module, package = place.with_suffix(".py"), place / "__init__.py"
            if not (module.exists() or package.exists() or place.name == folder.name):
                found.add(str(path.relative_to(ROOT)))
    return found


NUMPY_2 = (
    "acos acosh asin asinh astype atan atan2 atanh bitwise_count bitwise_invert bitwise_left_shift bitwise_right_shift"
    " concat cumulative_prod cumulative_sum isdtype matrix_transpose matvec permute_dims pow trapezoid unique_all"
    " unique_counts unique_inverse unique_values unstack vecdot vecmat"
)
"""Functions that NumPy 1.26, which comes with ROS from apt, does not have."""


def test_numpy_of_ros_from_apt_has_every_function() -> None:
    used = {
        f"{module}: np.{node.attr}"
        for module, path in SOURCES.items()
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Attribute) and node.attr in NUMPY_2.split()
        if isinstance(node.value, ast.Name) and node.value.id == "np"
    }
    assert used == set()


def test_tests_stand_where_their_modules_stand() -> None:
    assert _homeless_tests() == TESTS_TO_MOVE | set(TESTS_OF_MORE)


def test_a_circle_and_a_needless_exception_are_found() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"a"}}
    with pytest.raises(AssertionError, match="import circle: "):
        _check_circles(graph, set())
    _check_circles(graph, {("c", "a")})
    with pytest.raises(AssertionError, match="a -> c closes no circle"):
        _check_circles(graph, {("c", "a"), ("a", "c")})


def test_an_escape_is_found() -> None:
    for source in (
        "node._rcl.handle",
        "import ctypes",
        "node.__class__ = Other",
        "writer._Writer__chunks = ours",
        "exec(text)",
        "sys.modules['x'] = empty",
        "del sys.modules['x']",
        "from numba.core._helper import name",
    ):
        assert list(_escapes(ast.parse(source))), source
    assert not list(_escapes(ast.parse("self._parent\nself._x = 1\nother._x\nrow._replace(a=1)")))


def test_imports_in_functions_and_of_submodules_count() -> None:
    source = "import p.a\ndef f():\n    from p import b, name\n    from q import other\n"
    assert list(_imported("m", {"p": 0, "p.a": 0, "p.b": 0}, ast.parse(source))) == [
        "p.a",
        "p.b",
        "p",
    ]
