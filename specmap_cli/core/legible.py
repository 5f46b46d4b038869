"""Names as they can be shown: a topic, a frame and a file may be called by any bytes."""

from __future__ import annotations

import re

# Control characters (C0, DEL, C1), line and paragraph separators, marks and overrides of direction.
_UNSHOWN = re.compile(
    "[\x00-\x1f\x7f-\x9f\u2028\u2029\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]"
)


def legible(text: str) -> str:
    """`text` in one line that shows what it holds.

    Escaped are line breaks and other control characters, which a terminal would obey, those that
    turn the direction of writing, and what is no Unicode.
    """
    return encodable(_UNSHOWN.sub(lambda match: ascii(match[0])[1:-1], text))


def legible_json(text: str) -> str:
    """JSON with JSON's own escapes for what `legible` escapes; it is read back as it was."""
    return _UNSHOWN.sub(lambda match: match[0] if match[0] == "\n" else _escaped(match[0]), text)


def _escaped(character: str) -> str:
    return f"\\u{ord(character):04x}"


def encodable(text: str) -> str:
    """`text` with escapes for what is no Unicode."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")
