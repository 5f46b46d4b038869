"""What a validation found, in our words: those of pydantic never reach a person."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pydantic import ValidationError

# By pydantic's type of a finding; a name in braces is a bound that the finding has with it.
_WORDS = {
    "missing": "is missing",
    "extra_forbidden": "is unknown",
    "greater_than": "must be more than {gt:g}",
    "greater_than_equal": "must be {ge:g} or more",
    "less_than": "must be less than {lt:g}",
    "less_than_equal": "must be {le:g} or less",
    "finite_number": "must be a finite number",
    "literal_error": "must be {expected}",
    "string_pattern_mismatch": "must fit the pattern {pattern}",
    "too_short": "must have {min_length} entries or more",
    "too_long": "must have {max_length} entries or fewer",
    "model_type": "must be a table",
    "dict_type": "must be a table",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "bool_type": "must be true or false",
    "bool_parsing": "must be true or false",
    "float_type": "must be a number",
    "float_parsing": "must be a number",
    "int_type": "must be a whole number",
    "int_parsing": "must be a whole number",
    "int_parsing_size": "must be a whole number of fewer digits",
    "int_from_float": "must be a whole number",
    "string_type": "must be text",
    "union_tag_invalid": "must be one of {expected_tags}",
}


def said(finding: Mapping[str, Any]) -> str:
    """What a finding of `ValidationError.errors()` says, without its place and what was found.

    >>> said({"type": "greater_than_equal", "ctx": {"ge": 8}, "msg": "Input should be ..."})
    'must be 8 or more'
    """
    about = finding.get("ctx", {})
    if finding["type"] in ("value_error", "assertion_error"):
        return str(about["error"])
    if finding["type"] in _WORDS:
        return _WORDS[finding["type"]].format(**about)
    return str(finding["msg"]).replace("Input should", "must")


def first_finding(error: ValidationError) -> str:
    """The first finding of a validation, as `KEY: what is wrong`; entries of lists by number."""
    finding = error.errors()[0]
    key = ".".join(f"{part!s:.60}" for part in finding["loc"])
    return f"{key}: {said(finding)}" if key else said(finding)
