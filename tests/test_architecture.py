"""The house rules: which part may import which, and what no part may do."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import specmap_cli

ROOT = Path(specmap_cli.__file__).parent
FLOOR = {
    "config",
    "errors",
    "geometry",
    "gridmap",
    "keyframes",
    "mapfiles",
    "matching",
    "progress",
    "records",
    "scorefield",
    "tomltext",
    "topomap",
}
PACKAGES = {"logs", "registration", "segmentation", "recognition", "topology", "outputs"}
# what `specmap --help` must not load
HEAVY = {
    "cv2",
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


def part_of(path: Path) -> str:
    """The package or the top module of a file: `logs`, `gridmap`, `cli`, `__init__`."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


LIBRARY = [path for path in MODULES if part_of(path) not in {"cli", "__main__"}]


def allowed(part: str) -> set[str]:
    """The parts that `part` may import."""
    everything = {part_of(path) for path in MODULES}
    if part in FLOOR:
        return FLOOR | {"__init__"}
    if part in PACKAGES:
        return FLOOR | {part, "__init__"}
    if part in {"cli", "__main__"}:
        return everything
    if part == "evaluation":
        return everything - {"cli", "__main__"}
    return everything - {"cli", "__main__", "evaluation"}  # the pipeline and its like


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


def test_the_parts_are_all_there() -> None:
    assert {part_of(path) for path in MODULES} >= FLOOR | PACKAGES | {"cli", "evaluation"}


@pytest.mark.parametrize("path", MODULES, ids=relative)
def test_imports_go_one_way(path: Path) -> None:
    permitted = allowed(part_of(path)) | {"__version__"}
    for line, name in imports(path):
        top, _, rest = name.partition(".")
        if top == "specmap_cli" and rest:
            imported = rest.split(".")[0]
            assert imported in permitted, f"{path}:{line} imports {name}"


@pytest.mark.parametrize("path", sorted(ROOT.glob("cli/*.py")), ids=relative)
def test_commands_import_what_is_heavy_only_when_they_run(path: Path) -> None:
    light = {"cli", "errors", "progress", "__version__"}
    for line, name in imports(path, late=False):
        top, _, rest = name.partition(".")
        assert top not in HEAVY, f"{path}:{line} imports {name}"
        if top == "specmap_cli" and rest:
            assert rest.split(".")[0] in light, f"{path}:{line} imports {name}"


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


@pytest.mark.parametrize("path", LIBRARY, ids=relative)
def test_no_error_is_swallowed_without_being_known(path: Path) -> None:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ExceptHandler) and not isinstance(node.body[-1], ast.Raise):
            caught = "" if node.type is None else ast.unparse(node.type)
            assert caught not in {"", "Exception", "BaseException"}, f"{path}:{node.lineno}"
