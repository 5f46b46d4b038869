"""Programs that read what is exported; a test of one that is not installed is skipped."""

from typing import Any

import pytest

# Which extra of the project installs a consumer. The rest is too large for a gate.
_EXTRAS = {"rerun": "rerun", "evo": "none"}


def consumer(module: str) -> Any:
    extra = _EXTRAS.get(module.split(".")[0], "consumers")
    how = "install it by hand" if extra == "none" else f"pip install -e '.[{extra}]'"
    return pytest.importorskip(module, reason=f"{module} is not installed: {how}")
