"""What Typer lacks: groups of options, and options of several values.

A group is a dataclass whose fields are the options. A command takes it as one parameter, and Typer,
which reads the signature, finds its fields there instead::

    @dataclass(frozen=True, slots=True, kw_only=True)
    class Common:
        quiet: Annotated[bool, typer.Option("--quiet", "-q")] = False

    def info(logs: Logs, common: Common) -> None: ...  # Typer sees: logs, quiet

Typer has options of several values, and options that may be repeated, but none that are both, as in
`--rename 3 Kitchen`. Here an option whose metavar has two words takes as many values; the command
gets them joined.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING, fields, is_dataclass
from inspect import Parameter
from itertools import takewhile
from typing import Any, get_type_hints

from typer.core import TyperCommand

from specmap_cli.core.errors import UsageError

_JOINT = "\x1f"  # no shell and no keyboard gives it


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


class JoinedCommand(TyperCommand):
    """A command that joins the values of such options before Typer sees them."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments."""
        options = {option for parameter in self.params for option in parameter.opts}
        several = {
            option: len(metavar.split())
            for parameter in self.params
            for option in parameter.opts
            if option.startswith("-") and " " in (metavar := parameter.metavar or "")
        }
        return super().parse_args(ctx, _joined(args, several, options))


def values_of(option: str, joined: str, names: str) -> list[str]:
    """The values of one use of an option; UsageError when there are not as many as `names`."""
    values = joined.split(_JOINT)
    if len(values) != len(names.split()):
        raise UsageError(f"{option} {' '.join(values)}: expected {option} {names}")
    return values


def _joined(args: list[str], several: Mapping[str, int], options: Collection[str]) -> list[str]:
    """The arguments, those that belong to one use of an option joined; another option ends them."""
    joined: list[str] = []
    rest = list(args)
    while rest:
        word = rest.pop(0)
        joined.append(word)
        if word == "--":
            return [*joined, *rest]
        values = list(takewhile(lambda value: value not in options, rest[: several.get(word, 0)]))
        if values:
            del rest[: len(values)]
            joined.append(_JOINT.join(values))
    return joined
