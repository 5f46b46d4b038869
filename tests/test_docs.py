"""What the documents say exists: functions, settings, tests, options, and the files linked to."""

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import typer

from specmap_cli.cli.app import app
from specmap_cli.core.findings import Finding, Quality, Severity
from specmap_cli.core.settings import Config
from specmap_cli.pipelines.reports import BuildReport

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "specmap_cli"
DOCUMENTS = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "benchmarks/README.md")),
    *(ROOT / "sample_logs").glob("*.md"),
    *sorted((ROOT / "docs").glob("*.md")),
]
TEXTS = {path: path.read_text(encoding="utf-8") for path in DOCUMENTS}
OPTIONS = {
    name: {option for parameter in command.params for option in parameter.opts} | {"--help"}
    for name, command in typer.main.get_command(app).commands.items()  # type: ignore[attr-defined]
}


def named(path: Path) -> str:
    """How a document is called in the report of a test."""
    return str(path.relative_to(ROOT))


def quoted(text: str) -> Iterator[str]:
    """Everything between single backticks."""
    yield from re.findall(r"(?<!`)`([^`\n]+)`(?!`)", text)


def exists(name: str) -> bool:
    """Whether a dotted name is a setting, or a module of the package with the attributes named."""
    section, _, key = name.partition(".")
    if key in getattr(type(getattr(Config(), section, None)), "model_fields", {}):
        return True
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(["specmap_cli", *parts[:count]]))
        except ModuleNotFoundError:
            continue
        for attribute in parts[count:]:
            if not hasattr(found, attribute):
                return False
            found = getattr(found, attribute)
        return True
    return False


def test_the_paper_s_map_names_what_exists_and_tests_that_do() -> None:
    text = (ROOT / "docs" / "paper_map.md").read_text(encoding="utf-8")
    dotted = {name for name in quoted(text) if re.fullmatch(r"[a-z_0-9]+(\.[A-Za-z_0-9]+)+", name)}
    names = {name for name in dotted if not name.endswith((".py", ".md"))}
    assert len(names) > 40
    assert [name for name in sorted(names) if not exists(name)] == []
    proofs = [name.split("::") for name in quoted(text) if "::" in name]
    assert len(proofs) > 20
    for path, test in proofs:
        tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
        assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, test


def test_the_way_to_a_change_names_every_package_and_files_that_exist() -> None:
    text = (ROOT / "docs" / "find_your_way.md").read_text(encoding="utf-8")
    packages = [f"{path.parent.name}/" for path in PACKAGE.rglob("*/__init__.py")]
    assert [name for name in sorted(packages) if name not in text] == []
    folders = (PACKAGE, ROOT / "tests", ROOT / "docs")
    modules = {path.name for folder in folders for path in folder.rglob("*.py")}
    assert [name for name in re.findall(r"\w+\.py\b", text) if name not in modules] == []
    paths = [name for name in quoted(text) if re.fullmatch(r"\w+(/\w+)+\.\w+", name)]
    assert len(paths) > 20
    assert [name for name in paths if not (PACKAGE / name).exists() | (ROOT / name).exists()] == []


def test_links_lead_somewhere() -> None:
    broken = [
        f"{named(path)}: {target}"
        for path, text in TEXTS.items()
        for target in re.findall(r"\]\(([^)\s#]+)[^)]*\)", text)
        if "://" not in target and not (path.parent / target).exists()
    ]
    assert broken == []


def test_what_examples_import_exists() -> None:
    missing = []
    for path, text in TEXTS.items():
        for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("specmap"):
                    module = importlib.import_module(node.module or "")
                    names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                    missing += [f"{named(path)}: {node.module}.{name}" for name in names]
    assert missing == []


def test_options_shown_exist() -> None:
    anywhere = set().union(*OPTIONS.values())
    unknown = []
    for path, text in TEXTS.items():
        for command, rest in re.findall(r"specmap ([a-z]+)([^`\n#]*)", text.replace("\\\n", " ")):
            shown = re.findall(r"(?<!\S)--?[a-z][a-z-]*", rest if command in OPTIONS else "")
            strange = [option for option in shown if option not in OPTIONS[command]]
            unknown += [f"{named(path)}: specmap {command} {option}" for option in strange]
        if path.parent.name != "benchmarks":
            shown = [words.split()[0].split("=")[0] for words in quoted(text) if words[:2] == "--"]
            unknown += [f"{named(path)}: {option}" for option in shown if option not in anywhere]
    assert unknown == []


def test_settings_shown_exist() -> None:
    dumped = Config().model_dump()
    sections = {name: set(keys) for name, keys in dumped.items() if isinstance(keys, dict)}
    unknown = []
    for path, text in TEXTS.items():
        for section, key in re.findall(r"(?<![\w./])([a-z]+)\.([a-z_0-9]+)\b(?!\.|\()", text):
            module = ROOT / "specmap_cli" / section / f"{key}.py"
            is_file = module.exists() or key in {"bag", "mcap", "md", "py", "tum", "txt"}
            if section not in sections or is_file or key in sections[section]:
                continue
            if not exists(f"{section}.{key}"):
                unknown.append(f"{named(path)}: {section}.{key}")
    assert unknown == []


def test_the_lines_that_the_tutorial_quotes_of_a_build_are_those_that_it_prints() -> None:
    text = TEXTS[ROOT / "docs" / "tutorial.md"]
    table = text[text.index("| it says |") :].split("\n\n")[0]
    said = [found for row in table.splitlines() for found in quoted(row.split("|")[1])]
    counts = {"submaps": 1, "edges": 0, "merges": 0, "scans": 9, "path_m": 3.0, "lost": 0}
    printed = []
    for severity in get_args(Severity):
        finding = Finding(code="input", severity=severity, message="why")
        report = BuildReport(out=Path("map"), run={"counts": counts}, quality=Quality.of([finding]))
        printed += report.lines()
    assert len(said) == 4
    for line in said:
        assert any(line in each for each in printed), line
