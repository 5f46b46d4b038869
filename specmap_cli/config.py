"""Every setting and its default, on one page, a section a stage.

Flags go over the file (`--config specmap.toml`), the file over the preset, the preset over the
defaults here. Unknown keys are refused. `specmap config` prints what is in force as TOML.
"""

from __future__ import annotations

import json
import tomllib
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from specmap_cli.errors import UsageError


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class LogConfig(_Section):
    """Which messages are read and how a 3D cloud becomes a planar scan."""

    scan_topic: str | None = None
    odom_topic: str | None = None
    base_frame: str | None = None
    use_odometry: bool = True
    band_min_m: float = Field(0.15, description="height above the base's floor, lower end")
    band_max_m: float = Field(1.5, description="upper end")
    cloud_beams: int = Field(720, ge=16, description="bearings of the planar scan of a 3D cloud")


class KeyframeConfig(_Section):
    """When a scan goes on to mapping and training."""

    distance_m: float = Field(0.05, gt=0)
    angle_rad: float = Field(0.0524, gt=0)


class RegistrationConfig(_Section):
    """The front end: KISS-ICP on a window of keyframes."""

    min_range_m: float = Field(0.05, ge=0, description="nearer returns are the robot itself")
    max_range_m: float = Field(20.0, gt=0, description="farther returns are left out; planar")
    voxel_m: float = Field(0.1, gt=0, description="cell of the local map; kernels scale with it")
    max_points: int = Field(600, ge=50, description="a denser planar scan is thinned to this")
    min_points: int = Field(10, ge=3, description="a scan with fewer walls is lost")
    cloud_range_m: float = Field(40.0, gt=0, description="as max_range_m, for 3D clouds")
    cloud_voxel_m: float = Field(0.2, gt=0, description="as voxel_m, for 3D clouds")
    window_keyframes: int = Field(40, ge=1, description="keyframes in the local map")
    keyframe_m: float = Field(0.3, gt=0, description="motion between keyframes of the local map")
    keyframe_rad: float = Field(0.25, gt=0, description="turn between them")
    iterations: int = Field(50, ge=1, description="of the registration, per kernel")
    lost_limit: int = Field(5, ge=1, description="lost scans in a row that end a local map")


class GridConfig(_Section):
    """The occupancy grid of a submap."""

    resolution_m: float = Field(0.05, gt=0)
    max_range_m: float = Field(20.0, gt=0, description="beams are cut here and prove no obstacle")
    occupied_share: float = Field(0.25, gt=0, le=1, description="hits / (hits + misses) of a wall")
    surface_gap_m: float = Field(0.3, gt=0, description="returns this close bound one surface")
    footprint_m: float = Field(0.2, ge=0, description="radius of the robot, free where it stood")
    max_extent_m: float = Field(1000.0, gt=0, description="a grid never grows past this side")


class SegmentationConfig(_Section):
    """Section II of the paper. docs/segmentation.md says what each choice is for."""

    cell_m: float = Field(0.1, gt=0, description="cells of the working grid; finer is only slower")
    obstacle_m: float = Field(1.0, ge=0, description="isolated obstacles up to this size are free")
    fill: bool = Field(True, description="cells of removed obstacles take their room's label")
    nodes: Literal["clearest", "centre"] = Field("clearest", description="cell taken in a block")
    node_step_m: float = Field(0.7, gt=0, description="side of a block; one node a block")
    clearance_m: float = Field(0.25, ge=0, description="nodes and sight lines keep this off walls")
    sight_m: float = Field(5.0, gt=0, description="longest sight line")
    neighbours: int = Field(0, ge=0, description="l of eq. 1; 0: all visible nodes")
    eigenvalue_min: float = Field(0.7, gt=0, lt=1, description="k counts the eigenvalues above")
    labels: Literal["flood", "nearest"] = Field("flood", description="how cells get their label")
    merge: bool = Field(True, description="join clusters whose border is as wide as they are")
    merge_ratio: float = Field(0.9, gt=0, description="border width over room width that joins")
    width_percentile: float = Field(75.0, ge=0, le=100, description="of local widths: a room's")


class RecognitionConfig(_Section):
    """Section III of the paper."""


class RelaxationConfig(_Section):
    """The layout of the submaps."""

    enabled: bool = True


class LocalizationConfig(_Section):
    """The hidden Markov filter over the topology, and virtual scans."""


class Config(_Section):
    """All settings of a run."""

    preset: Literal["default", "paper"] = "default"
    seed: int = 0
    log: LogConfig = LogConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    registration: RegistrationConfig = RegistrationConfig()
    grid: GridConfig = GridConfig()
    segmentation: SegmentationConfig = SegmentationConfig()
    recognition: RecognitionConfig = RecognitionConfig()
    relaxation: RelaxationConfig = RelaxationConfig()
    localization: LocalizationConfig = LocalizationConfig()


# What the paper itself did, as differences from the defaults.
PRESETS: dict[str, dict[str, Any]] = {
    "default": {},
    "paper": {},
}


def load_config(
    path: Path | None = None,
    preset: str | None = None,
    overrides: dict[str, Any] | None = None,
) -> Config:
    """The effective configuration: `overrides` over the file over the preset over the defaults.

    `overrides` and the presets are nested dictionaries of the sections above. Raises UsageError
    naming the key at fault for an unreadable file, an unknown key or a value out of range.
    """
    from_file = _read_toml(path) if path is not None else {}
    name = preset or from_file.get("preset", "default")
    if name not in PRESETS:
        raise UsageError(f"unknown preset {name!r}: choose from {', '.join(sorted(PRESETS))}")
    merged = _merge(_merge(_merge({}, PRESETS[name]), from_file), overrides or {})
    merged["preset"] = name
    try:
        return Config.model_validate(merged)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        where = f"{path}: " if path is not None else ""
        raise UsageError(
            f"{where}{key}: {first['msg']}; run `specmap config` to see every key and its default"
        ) from None


def to_toml(config: Config) -> str:
    """The configuration as TOML with a comment a documented key; `load_config` reads it back."""
    lines = [f"preset = {_toml_value(config.preset)}", f"seed = {config.seed}"]
    for name in type(config).model_fields:
        section = getattr(config, name)
        if not isinstance(section, BaseModel):
            continue
        lines += ["", f"[{name}]"]
        for key, field in type(section).model_fields.items():
            value = getattr(section, key)
            comment = f"  # {field.description}" if field.description else ""
            if value is None:  # TOML has no null: an absent key is the default
                lines.append(f"# {key} ={comment or ' unset'}")
            else:
                lines.append(f"{key} = {_toml_value(value)}{comment}")
    return "\n".join(lines) + "\n"


def _toml_value(value: Any) -> str:
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_toml_value(each) for each in value) + "]"
    return json.dumps(value)


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8 text"
        raise UsageError(f"{path}: cannot read the configuration: {reason}") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from None


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """A nested dictionary with the entries of `over` in place of those of `base`."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both else value
    return merged
