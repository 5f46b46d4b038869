"""Which options the steps of a job have, and what their values are.

The batch itself says where results go and how they are told: `--out`, `--overwrite`, `--json` and
`--quiet` are nobody else's. A test compares this table with the command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from specmap_cli.batch.records import Command

Meaning = Literal["flag", "text", "input", "output"]


@dataclass(frozen=True, slots=True)
class Option:
    """What an option takes: nothing, a text, the path of an input, the name of an output."""

    meaning: Meaning
    several: bool = False


_FLAG, _TEXT, _INPUT, _OUTPUT = (Option(meaning) for meaning in ("flag", "text", "input", "output"))
_SETTINGS = {"preset": _TEXT, "config": _INPUT, "set": Option("text", several=True)}
_LOG_SETTINGS = {
    **_SETTINGS,
    "scan-topic": _TEXT,
    "scan-frame": _TEXT,
    "odom-topic": _TEXT,
    "base-frame": _TEXT,
    "no-odometry": _FLAG,
}
OPTIONS: Mapping[Command, Mapping[str, Option]] = {
    "build": {
        "no-relax": _FLAG,
        "explain": _OUTPUT,
        "seed": _TEXT,
        "like": _INPUT,
        "fail-on": _TEXT,
        **_LOG_SETTINGS,
    },
    "localize": {
        "map": _INPUT,
        "plot": _OUTPUT,
        "offline": _FLAG,
        "metric": _FLAG,
        **_LOG_SETTINGS,
    },
    "evaluate": {
        "protocol": _TEXT,
        "baseline": _TEXT,
        "relations": _INPUT,
        "reference": Option("input", several=True),
        "rooms": Option("input", several=True),
        "resolution": _TEXT,
        "split": _TEXT,
        "share": _TEXT,
        "block": _TEXT,
        "seed": _TEXT,
        **_LOG_SETTINGS,
    },
    "export": {"format": Option("text", several=True), **_SETTINGS},
    "report": {"compare": _INPUT, **_SETTINGS},
    "check": {
        "rules": _INPUT,
        "against": _INPUT,
        "junit": _OUTPUT,
        "markdown": _OUTPUT,
        **_SETTINGS,
    },
}
# What the batch says itself.
_SAID = frozenset({"out", "overwrite", "json", "quiet", "log-level"})
OF_THE_BATCH: Mapping[Command, frozenset[str]] = {
    "build": _SAID,
    "localize": _SAID | {"output"},
    "evaluate": _SAID | {"confusion", "trajectory"},
    "export": _SAID,
    "report": _SAID,
    "check": _SAID - {"out"},
}


def inputs_in(command: Command, options: tuple[str, ...]) -> dict[int, str]:
    """The paths among the options of a step, by their place in it."""
    found = {}
    for place, option in enumerate(options):
        name, _, value = option.removeprefix("--").partition("=")
        if OPTIONS[command][name].meaning == "input":
            found[place] = value
    return found
