"""The text files of a map directory, read within bounds: what is wrong is a MapError of a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from specmap_cli.core.errors import MapError
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.maps.tables import read_text


def map_text(path: Path, limits: LimitsConfig) -> str:
    """The text of a file."""
    try:
        return read_text(path, limits)
    except OSError as error:
        raise MapError.of_system(
            error, "cannot be read", "build the map again", where=path
        ) from None
    except UnicodeDecodeError:
        raise MapError("not UTF-8 text", "build the map again", where=path) from None


def map_json(path: Path, limits: LimitsConfig) -> Any:
    """The contents of a JSON file."""
    try:
        return json.loads(map_text(path, limits))
    except json.JSONDecodeError as error:
        raise MapError(
            f"damaged JSON at line {error.lineno}: {error.msg}", "build the map again", where=path
        ) from None
    except RecursionError:
        raise MapError("JSON nested too deeply", "build the map again", where=path) from None
    except ValueError:  # Python reads no integer of thousands of digits
        raise MapError("a number of too many digits", "build the map again", where=path) from None


def first_finding(error: ValidationError) -> str:
    """The first finding of a validation, as `key: message`."""
    finding = error.errors()[0]
    key = ".".join(str(part) for part in finding["loc"])
    return f"{key}: {finding['msg']}" if key else str(finding["msg"])
