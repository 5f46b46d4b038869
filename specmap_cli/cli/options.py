"""Options that several commands share, and how they become a configuration."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from specmap_cli.core.errors import UsageError

Logs = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help="Recording: .mcap, rosbag2 directory or .db3, ROS 1 .bag, CARMEN .log; "
        "several files of one split recording together.",
        show_default=False,
    ),
]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", help="TOML file of settings (see `specmap config`).")
]
Preset = Annotated[
    str | None,
    typer.Option(help="default: what measures best; paper: the paper's own choices."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="One setting, such as grid.resolution_m=0.1; repeatable."
    ),
]
ScanTopic = Annotated[str | None, typer.Option(help="Topic of the scans, when several fit.")]
OdomTopic = Annotated[str | None, typer.Option(help="Topic of the odometry, when several fit.")]
BaseFrame = Annotated[str | None, typer.Option(help="Frame of the robot's base.")]
NoOdometry = Annotated[bool, typer.Option("--no-odometry", help="Do not use odometry.")]
Seed = Annotated[int | None, typer.Option(help="Seed of everything random.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no notes.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace an existing result.")]


def overrides(
    settings: list[str] | None,
    scan_topic: str | None = None,
    odom_topic: str | None = None,
    base_frame: str | None = None,
    no_odometry: bool = False,
    *,
    no_relax: bool = False,
    seed: int | None = None,
) -> dict[str, Any]:
    """The nested dictionary of settings that the flags of a command stand for.

    Raises UsageError for a setting that is no KEY=VALUE.
    """
    result: dict[str, Any] = {}
    for setting in settings or []:
        key, value = _parse(setting)
        _put(result, key, value)
    flags = {
        "log.scan_topic": scan_topic,
        "log.odom_topic": odom_topic,
        "log.base_frame": base_frame,
        "log.use_odometry": False if no_odometry else None,
        "relaxation.enabled": False if no_relax else None,
        "seed": seed,
    }
    for key, value in flags.items():
        if value is not None:
            _put(result, key, value)
    return result


def _parse(setting: str) -> tuple[str, Any]:
    """Key and value of KEY=VALUE; a value that is no TOML is a string."""
    key, separator, text = (part.strip() for part in setting.partition("="))
    if not separator or not all(key.split(".")):
        raise UsageError(f"--set {setting}: expected KEY=VALUE, such as grid.resolution_m=0.1")
    if key == "preset":
        raise UsageError(f"--set {setting}: choose a preset with --preset {text}")
    try:
        found = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):
        return key, text
    return key, found["value"] if len(found) == 1 else text


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    """Set the entry of a dotted key; a value in the place of a section gives way to the section."""
    *sections, name = key.split(".")
    for section in sections:
        inner = tree.get(section)
        if not isinstance(inner, dict):
            inner = tree[section] = {}
        tree = inner
    tree[name] = value
