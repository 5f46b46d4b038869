"""YAML by PyYAML: read without surprises, and written such that all its readers agree.

What is read is text, lists and mappings, and a model makes numbers of the words. So no rule of
YAML 1.1 takes `1:30` for ninety, and no tag makes an object.
"""

from __future__ import annotations

from typing import Any

import yaml

from specmap_cli.core.text import decimal, encodable

try:  # in C, twenty times as fast
    from yaml import CBaseLoader as _Words
except ImportError:
    from yaml import BaseLoader as _Words

_DEEPEST = 50  # of lists and mappings in each other; the files of others have some five
_TEXT, _FLOAT = "tag:yaml.org,2002:str", "tag:yaml.org,2002:float"


def read_yaml(data: bytes) -> Any:
    """The one document in `data`: mappings, lists and text, in each other; None without one.

    Raises ValueError, in one line, for what is no YAML, and for what has no place in a file of
    values: aliases, by which few bytes become many, a key that comes twice, deep nesting.
    """
    try:
        depth = 0
        for event in yaml.parse(data, Loader=_Loader):  # before anything is made of it
            depth += isinstance(event, yaml.CollectionStartEvent)
            depth -= isinstance(event, yaml.CollectionEndEvent)
            deep = depth > _DEEPEST
            if deep or isinstance(event, yaml.AliasEvent):
                problem = "nested too deeply" if deep else "aliases (`*`) are not read"
                raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        return yaml.load(data, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f"line {mark.line + 1}: "
        raise ValueError(f"{where}{error.problem or error.context}") from None
    except yaml.YAMLError:  # of the characters
        raise ValueError("not a text file") from None


class _Loader(_Words):  # type: ignore[misc]
    """All scalars are text."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        """A mapping; a key that comes twice is refused."""
        made = super().construct_mapping(node, deep)
        if len(made) < len(node.value):
            raise yaml.MarkedYAMLError(
                problem="a key comes twice in what begins here", problem_mark=node.start_mark
            )
        return made


def yaml_text(value: dict[str, Any]) -> str:
    """A mapping as a document; its values are mappings, lists, text, numbers and booleans.

    Text is quoted, so that no word is taken for a number or for true, by YAML 1.1 or 1.2. Numbers
    have a point and no exponent: YAML 1.1 takes 1e-05 for text.
    """
    text: str = yaml.dump(
        value,
        Dumper=_Dumper,
        allow_unicode=True,
        default_flow_style=False,
        sort_keys=False,
        width=float("inf"),
    )
    return text


class _Dumper(yaml.SafeDumper):  # type: ignore[misc]
    """Lists stand further in than their key, and nothing is written as an alias."""

    def increase_indent(self, flow: bool = False, **_: Any) -> None:
        """Indent what follows, lists as well."""
        super().increase_indent(flow)

    def ignore_aliases(self, _: Any) -> bool:
        """What comes twice is written twice."""
        return True


def _mapping(dumper: _Dumper, value: dict[str, Any]) -> Any:
    node = dumper.represent_dict(value)
    for key, _ in node.value:
        key.style = None  # our keys are plain words
    return node


_Dumper.add_representer(dict, _mapping)
_Dumper.add_representer(str, lambda to, text: to.represent_scalar(_TEXT, encodable(text), '"'))
_Dumper.add_representer(float, lambda to, value: to.represent_scalar(_FLOAT, decimal(value)))
