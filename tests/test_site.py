"""The site of the documents: every page has a place, links hold, nothing comes from outside."""

import ast
import importlib.util
import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import typer

from specmap_cli.cli.app import app
from specmap_cli.core.schemas import schema_names
from tests.plugins import module_at

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
TROUBLE = (DOCS / "troubleshooting.md").read_text(encoding="utf-8")


HOOKS = module_at(DOCS / "hooks.py")


def nav() -> list[str]:
    """The pages that the site shows, in order."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8").partition("\nnav:")[2]
    return re.findall(r"([\w-]+\.md)\b", text)


def test_every_page_has_a_place_on_the_site() -> None:
    pages = {path.name for path in DOCS.glob("*.md")}
    pages |= {uri for uri in HOOKS.OUTSIDE.values() if uri.endswith(".md")}
    assert sorted(nav()) == sorted(pages | set(HOOKS.GENERATED))


@pytest.mark.parametrize(
    ("path", "uri", "link", "leads"),
    [
        ("docs/logs.md", "logs.md", "(../benchmarks/README.md#a)", "(benchmarks.md#a)"),
        ("docs/logs.md", "logs.md", "(tuning.md#b)", "(tuning.md#b)"),
        ("docs/logs.md", "logs.md", "(images/a.png)", "(images/a.png)"),
        ("docs/logs.md", "logs.md", "(#here)", "(#here)"),
        ("docs/logs.md", "logs.md", "(https://example.org/a.md)", "(https://example.org/a.md)"),
        ("README.md", "index.md", "(docs/logs.md)", "(logs.md)"),
        ("README.md", "index.md", "(docs/images/a.png)", "(images/a.png)"),
        ("benchmarks/README.md", "benchmarks.md", "(../docs/logs.md#c)", "(logs.md#c)"),
        ("sample_logs/README.md", "sample_logs.md", "(office.png)", "(images/sample_office.png)"),
    ],
)
def test_links_lead_to_the_place_on_the_site(path: str, uri: str, link: str, leads: str) -> None:
    assert HOOKS.relinked(f"see [it]{link}.", path, uri) == f"see [it]{leads}."


def test_lists_and_tables_begin_after_an_empty_line_and_a_link_to_nothing_is_text() -> None:
    assert HOOKS.relinked("[the code](../pyproject.toml)", "docs/a.md", "a.md") == "the code"
    given = "one:\n- a\n- b\n  more\n- c\n\ntwo:\n| x |\n|---|\n\n```\ntext\n- no list\n```\n"
    wanted = "one:\n\n- a\n- b\n  more\n- c\n\ntwo:\n\n| x |\n|---|\n\n```\ntext\n- no list\n```\n"
    assert HOOKS.roomy(given) == wanted


def test_the_pages_of_commands_and_settings_have_them_all() -> None:
    assert "[segmentation]\n" in HOOKS.settings_page()
    page = HOOKS.commands_page()
    for name in typer.main.get_command(app).commands:  # type: ignore[attr-defined]
        assert f"\n## {name}\n```\nUsage: specmap {name} " in page


def test_the_page_of_schemas_has_every_object_and_its_links_hold() -> None:
    page = HOOKS.schemas_page()
    for name in schema_names():
        assert f"\n## {name}\n" in page
    titles = re.findall(r"^### (.*)$", page, re.MULTILINE)
    anchors = {re.sub(r"[^\w\s-]", "", title).strip().lower().replace(" ", "-") for title in titles}
    assert len(anchors) == len(titles) > 20
    assert set(re.findall(r"\]\(#([^)]*)\)", page)) <= anchors


@cache
def texts_of_the_program() -> str:
    """All texts in the code; what is put into one when it runs is left out."""
    found = []
    for path in (ROOT / "specmap_cli").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


def messages() -> list[str]:
    """What the page by symptom says that the program prints."""
    tables = re.split(r"^## ", TROUBLE, flags=re.MULTILINE)
    rows = [
        row
        for table in tables
        if "| it says |" in table
        for row in re.findall(r"^\| (`.*?`) \|", table, re.MULTILINE)
    ]
    assert len(rows) > 15
    return [row.strip("` ") for row in rows]


@pytest.mark.parametrize("message", messages())
def test_messages_are_quoted_as_the_program_prints_them(message: str) -> None:
    program = texts_of_the_program()
    for piece in re.split(r"\.\.\.|: |; ", message):  # an error is made of parts
        assert piece.strip(" ;:") in program, piece


def test_the_site_is_built_and_every_link_holds(tmp_path: Path) -> None:
    for package in ("mkdocs", "material"):
        if importlib.util.find_spec(package) is None:
            pytest.skip(f"the site needs {package}: make docs installs it")
    site = tmp_path / "site"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(site)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
    )
    assert done.returncode == 0, done.stderr
    pages = list(site.glob("*.html"))
    assert len(pages) >= len(nav())
    for page in pages:
        html = page.read_text(encoding="utf-8")
        loaded = re.findall(r"<(?:script|img|iframe)[^>]* src=\"?([^\" >]+)", html)
        loaded += re.findall(r"<link[^>]* href=\"?([^\" >]+)", html)
        outside = [target for target in loaded if re.match(r"(https?:)?//", target)]
        assert outside == [], f"{page.name}: needs the network"
