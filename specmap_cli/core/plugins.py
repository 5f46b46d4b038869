"""What other packages add: readers, exporters, registration methods, sets of features; extras.

A package offers something by an entry point in its own pyproject.toml, under the group of its kind:
`specmap.readers`, `specmap.exporters`, `specmap.registration` or `specmap.features`::

    [project.entry-points."specmap.readers"]
    my_format = "my_package.reader:MyReader"
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, TypeVar

from specmap_cli.core.errors import PACKAGE, UsageError

Kind = TypeVar("Kind")


def with_plugins(group: str, built_in: Mapping[str, Kind]) -> dict[str, Kind]:
    """The built-in things of a kind and those that installed packages offer, by name.

    Built-in ones come first, the others follow by name. Raises UsageError for an entry point that
    cannot be loaded, and for one that takes the name of another.
    """
    table = dict(built_in)
    for point in sorted(entry_points(group=group), key=lambda point: (point.name, point.value)):
        where = "a package" if point.dist is None else f"package {point.dist.name}"
        if point.name in table:
            raise UsageError(
                f"offers {point.name!r} in {group}, which exists already",
                "remove the package or rename its entry point",
                where=where,
                code=PACKAGE,
            )
        try:
            table[point.name] = point.load()
        except Exception as error:  # whatever fails in the package
            raise UsageError(
                f"its {point.group} entry {point.name!r} cannot be loaded: "
                f"{type(error).__name__}: {error}",
                "mend or remove the package",
                mark=";",
                where=where,
                code=PACKAGE,
            ) from error
    return table


def extra(module: str, package: str, needed: str, where: str | None = None) -> Any:
    """A module of a package that need not be there.

    Raises UsageError where it is not: `needed` says for what, and may show the `{error}`.
    """
    try:
        return import_module(module)
    except ImportError as error:
        found = needed.format(error=error)
        raise UsageError(found, f"pip install {package}", where=where, code=PACKAGE) from None
