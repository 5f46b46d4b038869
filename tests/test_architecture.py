"""The house rules: which part may import which, and what no part may do."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

import specmap_cli

ROOT = Path(specmap_cli.__file__).parent

# What each room may import beside itself: the rooms of a lower floor that it needs, no others.
_STAGE = {"core", "grids"}
_FEATURES, _LEARNING = "recognition/features", "recognition/learning"
_STAGES = {
    "logs",
    "logs/readers",
    "registration",
    "segmentation",
    _FEATURES,
    _LEARNING,
    "recognition/closure",
    "recognition/localization",
    "layout",
    "topology",
    "quality",
    "maps",
    "drawing",
    "simulation",
}
_ORDER = {"core", "grids", *_STAGES}
MAY_IMPORT: dict[str, set[str]] = {
    "core": set(),
    "grids": {"core"},
    "logs/readers": {"core"},
    "logs": {"core", "logs/readers"},
    "registration": _STAGE,
    "segmentation": _STAGE,
    _FEATURES: _STAGE,
    _LEARNING: _STAGE | {_FEATURES},
    "recognition/closure": _STAGE | {_FEATURES, _LEARNING},
    "recognition/localization": _STAGE | {_FEATURES, _LEARNING},
    "layout": _STAGE,
    "topology": _STAGE,
    "simulation": _STAGE,
    "quality": _STAGE | {"layout"},
    "maps": _STAGE | {"topology", "logs", "logs/readers"},
    "drawing": _STAGE | {"topology", "segmentation"},
    "exports": _STAGE | {"topology", "layout", "maps", "drawing"},
    "checking": _STAGE | {"topology", "maps"},
    "report": _STAGE | {"topology", "maps", "drawing"},
    "history": _STAGE | {"maps", "report"},
    "batch": _STAGE | {"topology", "maps", "checking", "logs", "logs/readers", "report"},
    "pipelines": {*_ORDER, "checking", "history", "report"},
    "evaluation": {*_ORDER, "pipelines"},
    "cli": {*_ORDER, "pipelines", "evaluation", "exports", "checking", "batch"},
}
MOST_ROOMS, MOST_FLOORS = 24, 10
# what `specmap --help` must not load
HEAVY = {
    "cv2",
    "jinja2",
    "kiss_icp",
    "mcap",
    "networkx",
    "numpy",
    "pydantic",
    "rosbags",
    "scipy",
    "sklearn",
}
MODULES = sorted(ROOT.rglob("*.py"))


def relative(path: Path) -> str:
    """How a module is called in the report of a test."""
    return str(path.relative_to(ROOT))


def room_of(path: Path) -> str:
    """The package that a file stands in: `logs`, `logs/readers`; empty for the root."""
    return str(path.relative_to(ROOT).parent).replace(".", "")


def room_of_module(name: str) -> str:
    """The room of an imported module by its full name."""
    parts = name.split(".")[1:]
    while parts and not (ROOT.joinpath(*parts)).is_dir():
        parts.pop()
    return "/".join(parts)


LIBRARY = [path for path in MODULES if room_of(path) not in {"cli", ""}]


def floor_of(room: str) -> int:
    """How many floors a room stands above the ground."""
    return 1 + max((floor_of(below) for below in MAY_IMPORT[room]), default=0)


def imports(path: Path, *, late: bool = True) -> Iterator[tuple[int, str]]:
    """Line and full name of every module a file imports; without those in functions if not late."""
    waiting: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            assert node.module is not None
            # `from specmap_cli import gridmap` imports a module, the others name theirs
            yield from (
                (
                    node.lineno,
                    f"{node.module}.{alias.name}" if node.module == "specmap_cli" else node.module,
                )
                for alias in node.names
            )
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" and not late:
            continue  # read by type checkers alone
        elif late or not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            waiting.extend(ast.iter_child_nodes(node))


def test_every_room_is_in_the_table() -> None:
    rooms = {room_of(path) for path in MODULES if path.name != "__init__.py"} - {""}
    assert rooms == set(MAY_IMPORT)


def test_the_house_is_small_and_no_arrow_runs_up() -> None:
    assert len(MAY_IMPORT) <= MOST_ROOMS
    assert max(floor_of(room) for room in MAY_IMPORT) <= MOST_FLOORS  # ends: there is no circle


def test_no_two_files_of_tests_have_one_name() -> None:
    """Pytest imports them by name: it could not tell them apart."""
    names = sorted(path.name for path in Path(__file__).parent.rglob("test_*.py"))
    assert [name for name, next_ in pairwise(names) if name == next_] == []


def test_nothing_stands_at_the_root() -> None:
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "__main__.py"}


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_imports_go_one_way(path: Path) -> None:
    room = room_of(path)
    for line, name in imports(path):
        if name.startswith("specmap_cli.") and room:
            below = room_of_module(name)
            allowed = {"", room, *MAY_IMPORT.get(room, set())}
            assert below in allowed, f"{path}:{line} imports {name}"


@pytest.mark.parametrize("path", sorted(ROOT.glob("cli/*.py")), ids=relative)
def test_commands_import_what_is_heavy_only_when_they_run(path: Path) -> None:
    light = (
        "cli",
        "core.errors",
        "core.legible",
        "core.progress",
        "core.shortage",
        "__version__",
    )
    for line, name in imports(path, late=False):
        top, _, rest = name.partition(".")
        assert top not in HEAVY, f"{path}:{line} imports {name}"
        if top == "specmap_cli" and rest:
            assert name.removeprefix("specmap_cli.").startswith(light), f"{path}:{line} {name}"


def test_the_command_line_starts_without_anything_heavy() -> None:
    code = "import sys, specmap_cli.cli; print(*sorted({m.split('.')[0] for m in sys.modules}))"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT.parent
    )
    assert not HEAVY & set(found.stdout.split())


def calls(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and full name of everything called: `print`, `sys.exit`."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            yield node.lineno, ast.unparse(node.func)


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_the_library_neither_prints_nor_exits_nor_runs_data(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    forbidden = {"print", "exit", "quit", "sys.exit", "os._exit", "eval", "exec", "breakpoint"}
    for line, name in calls(tree):
        assert name not in forbidden, f"{path}:{line} calls {name}"
    for line, name in imports(path):
        assert name.split(".")[0] not in {"pickle", "shelve", "marshal"}, f"{path}:{line}: {name}"


# Functions that hand any error on in another way than by raising it: to the parent, in words.
TELLERS = {("pipelines/worker.py", "_portable")}


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_no_error_is_swallowed_without_being_known(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    tellers = {
        handler
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef) and (relative(path), function.name) in TELLERS
        for handler in ast.walk(function)
    }
    for node in ast.walk(tree):
        if node in tellers:
            continue
        if isinstance(node, ast.ExceptHandler) and not isinstance(node.body[-1], ast.Raise):
            caught = "" if node.type is None else ast.unparse(node.type)
            assert caught not in {"", "Exception", "BaseException"}, f"{path}:{node.lineno}"
