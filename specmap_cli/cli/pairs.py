"""Options that take several values and may be given several times: `--rename 3 Kitchen`.

Typer has options of several values, and options that may be repeated, but none that are both. Here
an option whose metavar has two words takes as many values; the command gets them joined.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import takewhile
from typing import Any

from typer.core import TyperCommand

from specmap_cli.core.errors import UsageError

_JOINT = "\x1f"  # no shell and no keyboard gives it


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
