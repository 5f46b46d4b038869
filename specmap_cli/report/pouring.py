"""Templates, styles and scripts of a package made one page that needs no other file."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Callable, Iterable, Mapping
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from specmap_cli import __version__
from specmap_cli.core.text import encodable

PACKAGE = "specmap_cli.report"


def poured(
    package: str,
    template: str,
    context: Mapping[str, Any],
    filters: Mapping[str, Callable[..., Any]],
) -> str:
    """The text of a page; whatever it shows is escaped.

    Templates are those of `package`, and those of the report beside them.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in (package, PACKAGE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": True, "separators": (",", ":")}
    environment.filters.update(filters)
    return encodable(environment.get_template(template).render(context))


def page_parts(package: str, scripts: Iterable[str], styles: Iterable[str]) -> dict[str, Any]:
    """What a page has whatever it shows: script, its hash, style and version.

    Files are looked for in the folders of `package`, then in those of the report.
    """
    script = _joined(package, "scripts", scripts)
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    return {
        "script": script,
        "script_hash": f"sha256-{base64.b64encode(digest).decode('ascii')}",
        "style": _joined(package, "styles", styles),
        "version": __version__,
    }


def _joined(package: str, folder: str, names: Iterable[str]) -> str:
    """Files of a folder, one after the other."""
    return "\n".join(_found(package, folder, name) for name in names)


def _found(package: str, folder: str, name: str) -> str:
    own = resources.files(package) / folder / name
    home = own if own.is_file() else resources.files(PACKAGE) / folder / name
    return home.read_text(encoding="utf-8")
