"""What mkdocs asks for while it builds the site: pages made from the code, and links that hold.

The pages of docs/ are written for a plain view of the repository. On the site the pages beside
docs/ have a place, too, and links to them lead there; a link to a file that the site does not have
becomes plain text.
"""

from __future__ import annotations

import json
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parent.parent
OUTSIDE = {  # files of the repository, and what they are on the site
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "benchmarks/README.md": "benchmarks.md",
    "sample_logs/README.md": "sample_logs.md",
    "sample_logs/office.png": "images/sample_office.png",
}
_LINK = re.compile(r"\[((?:[^\[\]]|\[[^\[\]]*\])*)\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^\s*```")
_BLOCK = re.compile(r"^(\s*[-*] |\s*\d+\. |\|)")  # an item of a list, a row of a table


def on_files(files: Any, config: Any) -> Any:
    """The pages of the site: those of docs/, those beside it, and those made from the code."""
    from mkdocs.structure.files import File

    for path, uri in OUTSIDE.items():
        files.append(File.generated(config, uri, abs_src_path=str(ROOT / path)))
    for uri, make in GENERATED.items():
        files.append(File.generated(config, uri, content=make()))
    return files


def on_page_markdown(markdown: str, page: Any, **_others: Any) -> str:
    """A page as the site needs it."""
    uri = page.file.src_uri
    if uri in GENERATED:
        return markdown
    sources = {uri: path for path, uri in OUTSIDE.items()}
    return roomy(relinked(markdown, sources.get(uri, f"docs/{uri}"), uri))


def relinked(markdown: str, path: str, uri: str) -> str:
    """A page that lies at `path` in the repository, with the links that it needs at `uri`."""

    def lead(link: re.Match[str]) -> str:
        words, target = link.groups()
        file, hash_, anchor = target.partition("#")
        if "://" in target or not file:
            return link[0]
        there = posixpath.normpath(posixpath.join(posixpath.dirname(path), file))
        place = OUTSIDE.get(there, there.removeprefix("docs/"))
        if there not in OUTSIDE and not there.startswith("docs/"):
            return words
        way = posixpath.relpath(place, posixpath.dirname(uri) or ".")
        return f"[{words}]({way}{hash_}{anchor})"

    return _LINK.sub(lead, markdown)


def roomy(markdown: str) -> str:
    """With an empty line before each list and each table, which mkdocs wants and others do not."""
    lines: list[str] = []
    in_fence = False
    for line in markdown.splitlines():
        before = lines[-1] if lines else ""
        starts = bool(_BLOCK.match(line)) and not _BLOCK.match(before) and not before[:1].isspace()
        if before and not in_fence and starts:
            lines.append("")
        in_fence ^= bool(_FENCE.match(line))
        lines.append(line)
    return "\n".join(lines) + "\n"


def commands_page() -> str:
    """What every command says of itself."""
    import typer

    from specmap_cli.cli.app import app

    names = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    parts = ["# Commands\nMade from the program: this is what `specmap COMMAND --help` prints.\n"]
    parts += [f"## {name}\n```\n{_printed(name, '--help')}```\n" for name in names]
    return "\n".join(parts)


def settings_page() -> str:
    """All settings with their defaults."""
    return (
        "# Settings\nMade from the program: this is what `specmap config` prints. Give a changed "
        "copy back with `--config`, or change one with `--set SECTION.KEY=VALUE`.\n\n"
        f"```toml\n{_printed('config')}```\n"
    )


def _printed(*arguments: str) -> str:
    """What a command prints, at the width of a page."""
    from typer.testing import CliRunner

    from specmap_cli.cli.app import app

    done = CliRunner().invoke(app, list(arguments), prog_name="specmap", env={"COLUMNS": "100"})
    if done.exit_code:
        raise RuntimeError(f"specmap {' '.join(arguments)}: {done.output}")
    return done.output


def schemas_page() -> str:
    """Every JSON Schema of the package, a table an object."""
    from specmap_cli.core.schemas import read_schema, schema_names

    parts = [
        "# JSON schemas\nMade from the schemas that the package ships: of what each command prints "
        "with `--json`, and of each JSON file. `specmap schema NAME` prints one, for programs that "
        "check what they read.\n"
    ]
    for name in schema_names():
        schema = read_schema(name)
        parts.append(f"## {name}\n{schema['title']}: `{schema['$id']}`\n")
        parts += [f"{_object(name, *one)}\n" for one in _objects(name, schema)]
    return "\n".join(parts)


def _objects(name: str, schema: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The objects of a schema that have fields, the outermost first."""
    for title, one in [(str(schema.get("title", name)), schema), *schema.get("$defs", {}).items()]:
        if one.get("properties"):
            yield title, one


def _object(name: str, title: str, schema: Mapping[str, Any]) -> str:
    """The fields of an object."""
    rows = [f"### {name}: {title}", str(schema.get("description", "")), "", "| field | type | |"]
    rows.append("|---|---|---|")
    for field, about in schema["properties"].items():
        optional = "" if field in schema.get("required", []) else " (may be missing)"
        words = str(about.get("description", "")).replace("|", "\\|").replace("\n", " ")
        rows.append(f"| `{field}` | {_type(name, about)} | {words}{optional} |")
    return "\n".join(rows)


def _type(name: str, about: Mapping[str, Any]) -> str:
    """What a field holds, in a few words."""
    if "$ref" in about:
        title = about["$ref"].rsplit("/", 1)[-1]
        return f"[{title}](#{name}-{title.lower()})"
    if "anyOf" in about:
        return " or ".join(dict.fromkeys(_type(name, one) for one in about["anyOf"]))
    if "const" in about or "enum" in about:
        return ", ".join(f"`{json.dumps(one)}`" for one in about.get("enum", [about.get("const")]))
    if about.get("type") == "array" and "prefixItems" in about:
        return "[" + ", ".join(_type(name, one) for one in about["prefixItems"]) + "]"
    if about.get("type") == "array":
        return f"list of {_type(name, about.get('items', {}))}"
    kinds = about.get("type", "anything")
    return kinds if isinstance(kinds, str) else " or ".join(kinds)


GENERATED: dict[str, Callable[[], str]] = {
    "commands.md": commands_page,
    "settings.md": settings_page,
    "schemas.md": schemas_page,
}
