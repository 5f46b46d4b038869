"""The house rules: which part may import which, and what no part may do."""

import ast
from collections.abc import Iterator
from functools import cache
from itertools import pairwise
from pathlib import Path

import specmap_cli

ROOT = Path(specmap_cli.__file__).parent

# What each room may import beside itself: the rooms of a lower floor that it needs, no others.
_STAGE = {"core", "grids"}
_FEATURES, _LEARNING = "recognition/features", "recognition/learning"
_ORDER = {
    *("core", "grids", "logs", "logs/readers", "registration", "segmentation", "layout"),
    *(_FEATURES, _LEARNING, "recognition/closure", "recognition/localization"),
    *("topology", "quality", "maps", "drawing", "simulation"),
}
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
MOST_ROOMS, MOST_FLOORS = 24, 9
MOST_LINES, MOST_LINES_OF_A_FUNCTION = 460, 60
# what `specmap --help` must not load: tests/cli/test_cli_usage.py runs it
HEAVY = {
    *("cv2", "jinja2", "kiss_icp", "mcap", "networkx", "numpy", "pydantic", "rosbags"),
    *("scipy", "sklearn", "yaml"),
}
MODULES = sorted(ROOT.rglob("*.py"))


def relative(path: Path) -> str:
    """How a module is called in the report of a test."""
    return str(path.relative_to(ROOT))


@cache
def tree_of(path: Path) -> ast.Module:
    """A module as Python reads it."""
    return ast.parse(path.read_text(encoding="utf-8"))


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


@cache
def imports(path: Path, *, late: bool = True) -> list[tuple[int, str]]:
    """Line and full name of every module a file imports; without those in functions if not late."""
    found = []
    waiting: list[ast.AST] = [tree_of(path)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: relative import"
            assert node.module is not None
            # `from specmap_cli import gridmap` imports a module, the others name theirs
            whole = node.module == "specmap_cli"
            for alias in node.names:
                found.append((node.lineno, f"{node.module}.{alias.name}" if whole else node.module))
        elif isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING" and not late:
            continue  # read by type checkers alone
        elif isinstance(node, ast.stmt | ast.ExceptHandler | ast.match_case):
            inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
            waiting.extend(ast.iter_child_nodes(node) if late or not inside else ())
        elif isinstance(node, ast.Module):
            waiting.extend(node.body)
    return found


def test_every_room_is_in_the_table_the_house_is_small_and_no_arrow_runs_up() -> None:
    rooms = {room_of(path) for path in MODULES if path.name != "__init__.py"} - {""}
    assert rooms == set(MAY_IMPORT)
    assert {path.name for path in ROOT.glob("*.py")} == {"__init__.py", "__main__.py"}
    assert len(MAY_IMPORT) <= MOST_ROOMS
    assert max(floor_of(room) for room in MAY_IMPORT) <= MOST_FLOORS  # ends: there is no circle


def test_a_module_is_read_at_a_sitting_and_a_function_on_a_screen() -> None:
    long = []
    for path in MODULES:
        lines = path.read_text(encoding="utf-8").count("\n")
        long += [f"{relative(path)}: {lines} lines"] if lines > MOST_LINES else []
        for node in ast.walk(tree_of(path)):
            if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                lines = node.end_lineno - node.lineno + 1
                if lines > MOST_LINES_OF_A_FUNCTION:
                    long.append(f"{relative(path)}:{node.lineno} {node.name}: {lines} lines")
    assert long == []


def test_the_documents_tell_the_same_sizes() -> None:
    floors = max(floor_of(room) for room in MAY_IMPORT)
    sizes = f"A module has {MOST_LINES} lines at the most, a function {MOST_LINES_OF_A_FUNCTION}."
    told = {
        "CONTRIBUTING.md": (sizes,),
        "docs/find_your_way.md": (sizes, f"{len(MAY_IMPORT)} packages on {floors} floors"),
    }
    for name, sentences in told.items():
        text = (ROOT.parent / name).read_text(encoding="utf-8")
        assert [sentence for sentence in sentences if sentence not in text] == []


def test_no_two_files_of_tests_have_one_name() -> None:
    """Pytest imports them by name: it could not tell them apart."""
    names = sorted(path.name for path in Path(__file__).parent.rglob("test_*.py"))
    assert [name for name, next_ in pairwise(names) if name == next_] == []


def test_imports_go_one_way() -> None:
    wrong = []
    for path in MODULES:
        room = room_of(path)
        allowed = {"", room, *MAY_IMPORT.get(room, set())}
        for line, name in imports(path):
            if name.startswith("specmap_cli.") and room and room_of_module(name) not in allowed:
                wrong.append(f"{relative(path)}:{line} imports {name}")
    assert wrong == []


def test_commands_import_what_is_heavy_only_when_they_run() -> None:
    light = ("cli", "core.errors", "core.progress", "core.text", "__version__")
    wrong = []
    for path in sorted(ROOT.glob("cli/*.py")):
        for line, name in imports(path, late=False):
            top, _, rest = name.partition(".")
            if top in HEAVY or (top == "specmap_cli" and rest and not rest.startswith(light)):
                wrong.append(f"{relative(path)}:{line} imports {name}")
    assert wrong == []


def test_the_library_neither_prints_nor_exits_nor_runs_data() -> None:
    forbidden = {"print", "exit", "quit", "sys.exit", "os._exit", "eval", "exec", "breakpoint"}
    loads = {"pickle", "shelve", "marshal"}
    wrong = []
    for path in LIBRARY:
        where = relative(path)
        calls = [node for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)]
        called = [(node.lineno, ast.unparse(node.func)) for node in calls]
        wrong += [f"{where}:{line} calls {name}" for line, name in called if name in forbidden]
        loaded = [(line, name) for line, name in imports(path) if name.split(".")[0] in loads]
        wrong += [f"{where}:{line} imports {name}" for line, name in loaded]
    assert wrong == []


# Functions that hand any error on in another way than by raising it: to the parent, in words.
TELLERS = {("core/worker.py", "_portable")}


def handlers_in(path: Path) -> Iterator[ast.ExceptHandler]:
    """Every `except` of a module but for those in a teller."""
    waiting: list[ast.AST] = [tree_of(path)]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef) and (relative(path), node.name) in TELLERS:
            continue
        if isinstance(node, ast.ExceptHandler):
            yield node
        waiting.extend(ast.iter_child_nodes(node))


def test_no_error_is_swallowed_without_being_known() -> None:
    swallowing = []
    for path in LIBRARY:
        for handler in handlers_in(path):
            caught = "" if handler.type is None else ast.unparse(handler.type)
            known = caught not in {"", "Exception", "BaseException"}
            if not known and not isinstance(handler.body[-1], ast.Raise):
                swallowing.append(f"{relative(path)}:{handler.lineno}")
    assert swallowing == []
