"""What a reader has to hold: lines, modules, settings, constants, and how much a run goes through.

Functions and modules of the package that are entered by a call, in one process (`sys.setprofile`).
A constant is a name of a module, in capitals, that stands for a number or for several.
"""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

from pydantic import BaseModel

from benchmarks.data import SAMPLES
from benchmarks.scoreboard.bench import Bench
from benchmarks.scoreboard.digest import ROOT
from benchmarks.scoreboard.rows import Figures, Row
from specmap_cli.core.settings import Config

_ENTERED = """
import sys
from pathlib import Path
import specmap_cli
root = str(Path(specmap_cli.__file__).parent)
codes = set()

def look(frame, event, _):
    if event == "call":
        codes.add(frame.f_code)

map_, log, out = sys.argv[2:]
from specmap_cli.core.config import load_config
if sys.argv[1] == "build":
    from specmap_cli import build_map
    work = lambda: build_map(log, out)
elif sys.argv[1] == "localize":
    from specmap_cli import localize_log
    work = lambda: localize_log(log, map_, metric=True)
else:
    from specmap_cli.pipelines.update import update_map
    work = lambda: update_map(map_, log, out)
sys.setprofile(look)
work()
sys.setprofile(None)
optimized = 1  # a function, and not the body of a module or of a class
inside = [c for c in codes if c.co_filename.startswith(root) and c.co_flags & optimized]
named = {(code.co_filename, code.co_qualname) for code in inside if code.co_name[:1] != "<"}
print(len(named), len({file for file, _ in named}))
"""

ROWS = (
    Row("lines", "lines of source", 40_000, 38_000, "less", ",.0f"),
    Row("modules", "modules", 330, 280, "less", ".0f"),
    Row("settings", "settings", 100, 80, "less", ".0f"),
    Row("constants", "numeric constants", better="less", form=",.0f"),
    Row("tests", "lines of tests", 38_000, 32_000, "less", ",.0f"),
    Row("benchmarks", "lines of benchmarks", better="less", form=",.0f"),
    Row("docs", "words of docs and README", better="less", form=",.0f"),
    Row("build", "functions entered by `build_map`", 1000, 800, "less", ",.0f"),
    Row("build_modules", "in so many modules", 130, None, "less", ".0f"),
    Row("localize", "functions entered by `localize_log(metric=True)`", 480, 380, "less", ",.0f"),
    Row("localize_modules", "in so many modules", 75, None, "less", ".0f"),
    Row("update", "functions entered by `update_map`", 1100, 850, "less", ",.0f"),
    Row("update_modules", "in so many modules", 150, None, "less", ".0f"),
)


def measure(bench: Bench) -> Figures:
    """Count the tree, and what three calls go through."""
    sources = sorted((ROOT / "specmap_cli").rglob("*.py"))
    documents = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    figures: dict[str, float] = {
        "lines": lines_of(sources),
        "modules": len(sources),
        "settings": settings_in(Config),
        "constants": sum(constants_in(path) for path in sources),
        "tests": lines_of((ROOT / "tests").rglob("*.py")),
        "benchmarks": lines_of((ROOT / "benchmarks").rglob("*.py")),
        "docs": sum(len(path.read_text(encoding="utf-8").split()) for path in documents),
    }
    map_ = bench.simulated("office-sample", lambda log: log.symlink_to(SAMPLES / "office.mcap"))
    with bench.scratch("weight") as folder:
        for what in ("build", "localize", "update"):
            entered = functions_entered(what, map_, folder)
            figures |= {what: entered[0], f"{what}_modules": entered[1]}
    return figures


def lines_of(paths: Iterable[Path]) -> int:
    """How many lines some files have."""
    return sum(path.read_text(encoding="utf-8").count("\n") for path in paths)


def settings_in(section: type[BaseModel]) -> int:
    """How many settings a section has, with those of the sections in it."""
    total = 0
    for field in section.model_fields.values():
        kind = field.annotation
        inner = isinstance(kind, type) and issubclass(kind, BaseModel)
        total += settings_in(kind) if inner else 1  # type: ignore[arg-type]
    return total


def constants_in(path: Path) -> int:
    """How many names of a module stand for numbers."""
    count = 0
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
            if names and all(name.isupper() for name in names) and _is_number(node.value):
                count += len(names)
    return count


def _is_number(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone."""
    if isinstance(node, ast.Tuple | ast.List | ast.Set):
        return bool(node.elts) and all(_is_number(each) for each in node.elts)
    if isinstance(node, ast.UnaryOp):
        return _is_number(node.operand)
    if isinstance(node, ast.BinOp):
        return _is_number(node.left) and _is_number(node.right)
    return isinstance(node, ast.Constant) and type(node.value) in (int, float)


def functions_entered(what: str, map_: Path, folder: Path) -> tuple[int, int]:
    """How many functions of the package a call enters, and in how many modules they are."""
    command = [sys.executable, "-c", _ENTERED, what, str(map_), str(SAMPLES / "office_again.mcap")]
    done = subprocess.run(
        [*command, str(folder / what)],
        env={**os.environ, "SPECMAP_PROCESSES": "1"},
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    functions, modules = done.stdout.split()
    print(f"{what}: {functions} functions in {modules} modules", flush=True)
    return int(functions), int(modules)
