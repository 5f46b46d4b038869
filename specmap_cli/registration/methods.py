"""The registration methods by name: KISS-ICP and what installed packages offer.

A package offers a method by an entry point in its own pyproject.toml. Its name is then a value of
the setting `registration.method`::

    [project.entry-points."specmap.registration"]
    my-icp = "my_package.icp:MyAligner"

It names a class whose constructor takes the settings and the kind of sensor (`AlignerFactory`), or
a function that takes the same and returns an `Aligner`.
"""

from __future__ import annotations

from collections.abc import Mapping

from specmap_cli.core.errors import SETTING, UsageError
from specmap_cli.core.plugins import with_plugins
from specmap_cli.registration.aligner import AlignerFactory
from specmap_cli.registration.kiss_icp_aligner import KissIcpAligner

GROUP = "specmap.registration"
BUILT_IN: Mapping[str, AlignerFactory] = {"kiss-icp": KissIcpAligner}


def aligner_factory(name: str) -> AlignerFactory:
    """The registration method of a name; UsageError when there is none."""
    methods = with_plugins(GROUP, BUILT_IN)
    if name not in methods:
        raise UsageError(
            f"registration.method: no such method {name!r}: choose from {', '.join(methods)}, or "
            "install the package that offers it",
            code=SETTING,
        )
    return methods[name]
