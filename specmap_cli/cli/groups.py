"""Groups of options: a command takes one value for several options that belong together.

A group is a dataclass whose fields are the options. A command takes it as one parameter, and Typer,
which reads the signature, finds its fields there instead::

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Common:
        quiet: Annotated[bool, typer.Option("--quiet", "-q")] = False

    def info(logs: Logs, common: Common) -> None: ...  # Typer sees: logs, quiet
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from inspect import Parameter
from typing import Any, get_type_hints


def unfolded(command: Callable[..., None]) -> Callable[..., None]:
    """`command` as Typer must see it: the fields of each group in the place of the group.

    Raises ValueError for two options of one name.
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {
        name: hint for name, hint in hints.items() if isinstance(hint, type) and is_dataclass(hint)
    }
    parameters: list[Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        alone = parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name])
        parameters += _fields(groups[name]) if name in groups else [alone]

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        command(**values)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def _fields(group: type[Any]) -> Iterator[Parameter]:
    """The fields of a group as parameters; one without a default is required."""
    hints = get_type_hints(group, include_extras=True)
    for field in fields(group):
        default = Parameter.empty if field.default is MISSING else field.default
        yield Parameter(
            field.name, Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name]
        )
