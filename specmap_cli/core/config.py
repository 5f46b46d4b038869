"""Every setting and its default, on one page, a section a stage.

Flags go over the file (`--config specmap.toml`), the file over the preset, the preset over the
defaults here. Unknown keys are refused. `specmap config` prints what is in force as TOML.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from specmap_cli.core.errors import UsageError
from specmap_cli.core.tomltext import read_toml


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LogConfig(_Section):
    """Which messages are read and how a 3D cloud becomes a planar scan."""

    scan_topic: str | None = None
    odom_topic: str | None = None
    base_frame: str | None = None
    use_odometry: bool = True
    band_min_m: float = Field(0.15, description="height above the base's floor, lower end")
    band_max_m: float = Field(1.5, description="upper end")
    cloud_beams: int = Field(720, ge=16, description="bearings of the planar scan of a 3D cloud")
    cloud_range_max_m: float = Field(100.0, gt=0, description="a 3D cloud is cut here")

    @model_validator(mode="after")
    def _band_has_height(self) -> LogConfig:
        if self.band_min_m >= self.band_max_m:
            raise ValueError("band_min_m must be below band_max_m")
        return self


class KeyframeConfig(_Section):
    """When a scan goes on to mapping and training."""

    distance_m: float = Field(0.05, gt=0)
    angle_rad: float = Field(0.0524, gt=0)


class RegistrationConfig(_Section):
    """The front end: KISS-ICP on a window of keyframes."""

    min_range_m: float = Field(0.05, ge=0, description="nearer returns are the robot itself")
    max_range_m: float = Field(20.0, gt=0, description="farther returns are left out; planar")
    voxel_m: float = Field(0.1, ge=0.01, description="cell of the local map; kernels scale with it")
    max_points: int = Field(600, ge=50, description="a denser planar scan is thinned to this")
    min_points: int = Field(10, ge=3, description="a scan with fewer walls is lost")
    cloud_range_m: float = Field(40.0, gt=0, description="as max_range_m, for 3D clouds")
    cloud_voxel_m: float = Field(0.2, ge=0.01, description="as voxel_m, for 3D clouds")
    level_share: float = Field(
        0.2, ge=0, le=1, description="of a 3D lidar's roll and pitch taken back at every scan"
    )
    window_keyframes: int = Field(80, ge=1, description="keyframes in the local map")
    keyframe_m: float = Field(0.3, gt=0, description="motion between keyframes of the local map")
    keyframe_rad: float = Field(0.25, gt=0, description="turn between them")
    guess_margin: float = Field(
        0.05, ge=0, le=1, description="score by which steady motion must beat odometry as the guess"
    )
    iterations: int = Field(50, ge=1, description="of the registration, per kernel")
    lost_limit: int = Field(5, ge=1, description="lost scans in a row that end a local map")


class GridConfig(_Section):
    """The occupancy grid of a submap."""

    resolution_m: float = Field(0.05, ge=0.005, le=1.0, description="side of a cell")
    max_range_m: float = Field(20.0, gt=0, description="beams are cut here and prove no obstacle")
    occupied_share: float = Field(0.25, gt=0, le=1, description="hits / (hits + misses) of a wall")
    surface_gap_m: float = Field(0.3, gt=0, description="returns this close bound one surface")
    footprint_m: float = Field(
        0.2, ge=0, le=5, description="radius of the robot, free where it stood"
    )
    max_extent_m: float = Field(1000.0, gt=0, description="a grid never grows past this side")
    max_area_m2: float = Field(100_000.0, gt=0, description="nor past this area")


class SegmentationConfig(_Section):
    """Section II of the paper. docs/segmentation.md says what each choice is for."""

    cell_m: float = Field(
        0.1, ge=0.01, le=1.0, description="cells of the working grid; finer is only slower"
    )
    obstacle_m: float = Field(1.5, ge=0, description="isolated obstacles up to this size are free")
    furniture_m: float = Field(2.5, ge=0, description="and up to this size when they are thick")
    furniture_thick_m: float = Field(0.4, gt=0, description="tables are thicker than walls")
    fill: bool = Field(True, description="cells of removed obstacles take their room's label")
    nodes: Literal["clearest", "centre"] = Field("clearest", description="cell taken in a block")
    node_step_m: float = Field(0.7, gt=0, le=10, description="side of a block; one node a block")
    clearance_m: float = Field(0.25, ge=0, description="nodes and sight lines keep this off walls")
    sight_m: float = Field(5.0, gt=0, description="longest sight line")
    neighbours: int = Field(0, ge=0, description="l of eq. 1; 0: all visible nodes")
    eigenvalue_min: float = Field(0.75, gt=0, lt=1, description="k counts the eigenvalues above")
    halve: bool = Field(True, description="look for two clusters inside each cluster again")
    halve_eigenvalue: float = Field(0.7, gt=0, lt=1, description="its second one that halves it")
    labels: Literal["flood", "nearest"] = Field("flood", description="how cells get their label")
    merge: bool = Field(True, description="join clusters whose border is as wide as they are")
    merge_ratio: float = Field(0.8, gt=0, description="border width over room width that joins")
    width_percentile: float = Field(60.0, ge=0, le=100, description="of local widths: a room's")
    door_min_m: float = Field(0.3, ge=0, description="narrower contacts of regions are no doorway")
    test_every: Literal["metres", "keyframes"] = Field("metres", description="pace of the tests")
    test_metres: float = Field(1.0, gt=0, description="travelled between two tests")
    test_keyframes: int = Field(50, ge=1, description="keyframes between two tests")
    split_eigenvalue: float = Field(0.6, gt=0, lt=1, description="a second region is entered above")
    split_share: float = Field(0.1, ge=0, lt=0.5, description="least share of the way on each side")
    split_scale: float = Field(3.0, gt=0, description="sigma of eq. 1 in a test, times its median")
    split_obstacle_m: float = Field(1.0, ge=0, description="as obstacle_m, in a test")
    split_clearance_m: float = Field(0.3, ge=0, description="as clearance_m, in a test")
    split_sight_m: float = Field(1000.0, gt=0, description="as sight_m, in a test")
    split_nodes: int = Field(250, ge=16, description="most nodes in a test: the blocks grow")
    path_band_m: float = Field(2.0, ge=0, description="nodes lie this near the path; 0: anywhere")
    region_min_m: float = Field(1.0, ge=0, description="shortest way that is split off or goes on")
    regrow: bool = Field(True, description="a region the robot comes straight back to goes on")
    final_regions: bool = Field(True, description="submaps end where the finished map's do")


class RecognitionConfig(_Section):
    """Section III of the paper: features, boosting, loop closure."""

    feature_set: Literal["table1", "pairs", "shape", "places", "full"] = "full"
    booster: Literal["trees", "stumps"] = "trees"
    rounds: int = Field(200, ge=1, description="weak classifiers of a submap's final classifier")
    shrinkage: float = Field(0.5, gt=0, le=1, description="trees: scale of every vote")
    feature_share: float = Field(0.2, gt=0, le=1, description="trees: features drawn a round")
    negatives: int = Field(1500, ge=10, description="scans of other submaps a classifier sees")
    closure_rounds: int = Field(30, ge=1, description="weak classifiers while ranking")
    closure_shrinkage: float = Field(0.5, gt=0, le=1)
    closure_negatives: int = Field(400, ge=10)
    samples_per_submap: int = Field(100, ge=1, description="scans of a submap used for ranking")
    groups: int = Field(3, ge=0, description="held-out groups of old submaps; 0 = one by one")
    refresh_growth: float = Field(0.4, ge=0, description="retrain once the submaps grew by this")
    xi_threshold: float = Field(0.175, ge=0, le=1, description="eq. 5, judge without `verify`")
    verify: bool = Field(True, description="a closure needs a match of the two grids")
    candidates: int = Field(3, ge=1, description="best ranked old submaps whose grids are matched")
    leftovers: int = Field(2, ge=0, description="pairs matched a submap in search of duplicates")
    members: int = Field(2, ge=1, description="visits of an old submap whose grids are matched")
    min_score: float = Field(0.75, le=1, description="inliers less twice the contradictions")
    min_lead: float = Field(0.1, ge=0, description="over the next best match, or it is ambiguous")
    min_inliers: int = Field(100, ge=1, description="wall points that agree")
    min_overlap: float = Field(0.4, ge=0, le=1, description="shared part of one's walls")
    least_overlap: float = Field(0.15, ge=0, le=1, description="shared part of the other's walls")
    merge_overlap: float = Field(0.4, ge=0, le=1, description="of both tracks, for a merge")
    merge_reach_m: float = Field(1.0, gt=0, description="tracks this close overlap")
    max_drift: float = Field(
        0.1, ge=0, description="metres per metre driven that a closure may mend"
    )


class RelaxationConfig(_Section):
    """The layout of the submaps: a pose graph over the keyframes."""

    enabled: bool = True
    node_m: float = Field(0.3, gt=0, description="motion between nodes of the pose graph")
    node_rad: float = Field(0.25, gt=0, description="turn between them")
    match_range_m: float = Field(12.0, gt=0, description="farther returns are not matched")
    loop_every_m: float = Field(1.0, gt=0, description="path between searches for nearby passes")
    loop_path_m: float = Field(6.0, gt=0, description="less path than this between is no pass")
    loop_radius_m: float = Field(3.0, gt=0, description="how near a pass must be")
    loops_per_node: int = Field(2, ge=0, description="passes matched at the most, 0: none")
    loop_score: float = Field(0.6, ge=0, le=1, description="a match below this is no edge")
    stray_tries: int = Field(
        30, ge=0, description="searches to rejoin a piece of the path after tracking was lost"
    )
    solve_every: int = Field(12, ge=1, description="edges found before the layout is renewed")


class LocalizationConfig(_Section):
    """The hidden Markov filter over the topology, and virtual scans."""

    virtual: bool = Field(True, description="virtual full-circle scans over the last metres")
    feature_set: Literal["table1", "pairs", "shape", "places", "full"] = Field(
        "places", description="of virtual scans"
    )
    window_m: float = Field(10.0, gt=0, description="path whose scans make a virtual scan")
    virtual_beams: int = Field(360, ge=16)
    virtual_range_m: float = Field(20.0, gt=0)
    raw_weight: float = Field(0.1, ge=0, le=1, description="of the single scan; 1 at the start")
    augmentation: int = Field(1500, ge=0, description="virtual scans from free cells, training")
    stay: float = Field(
        0.97, gt=0, lt=1, description="chance to stay in a submap from scan to scan"
    )
    sharpness: float = Field(0.1, gt=0, description="scale of margins in the filter")
    unknown: bool = Field(True, description="allow the label unknown")
    false_unknown: float = Field(0.05, gt=0, lt=1, description="share of known scans given up")


class Config(_Section):
    """All settings of a run."""

    preset: Literal["default", "paper"] = "default"
    seed: int = Field(0, ge=0)
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
    "paper": {
        "segmentation": {
            "obstacle_m": 0.0,
            "furniture_m": 0.0,
            "fill": False,
            "nodes": "centre",
            "node_step_m": 0.5,
            "clearance_m": 0.0,
            "sight_m": 6.0,
            "neighbours": 60,  # the paper leaves l open; fewer cut every room into pieces
            "eigenvalue_min": 0.9,
            "halve": False,
            "labels": "nearest",
            "merge": False,
            "test_every": "keyframes",
            "split_eigenvalue": 0.8,
            "split_share": 0.0,
            "split_scale": 1.0,
            "split_obstacle_m": 0.0,
            "split_clearance_m": 0.0,
            "split_sight_m": 20.0,
            "path_band_m": 0.0,
            "region_min_m": 0.0,
            "regrow": False,
            "final_regions": False,
        },
        "recognition": {
            "feature_set": "table1",
            "booster": "stumps",
            "rounds": 300,
            "negatives": 1_000_000,
            "closure_negatives": 1_000_000,
            "groups": 0,
            "refresh_growth": 0.0,
            "verify": False,
            "closure_rounds": 60,
        },
        "localization": {"virtual": False, "unknown": False},
    },
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
    from_file = read_toml(path) if path is not None else {}
    name = preset or from_file.get("preset", "default")
    where = f"{path}: " if path is not None else ""
    if not isinstance(name, str) or name not in PRESETS:
        choices = ", ".join(sorted(PRESETS))
        source = where if preset is None else ""
        raise UsageError(f"{source}unknown preset {name!r}: choose from {choices}")
    if from_file.get("preset", name) != name and len(from_file) > 1:
        raise UsageError(
            f"{where}preset is {from_file['preset']!r}, but --preset {name} was given: the file's "
            "values would undo it; take the line `preset` and the values you do not want to keep "
            "out of the file"
        )
    merged = _merge(_merge(_merge({}, PRESETS[name]), from_file), overrides or {})
    return _validated({**merged, "preset": name}, where)


def with_overrides(config: Config, overrides: dict[str, Any]) -> Config:
    """The configuration with nested `overrides` over it; UsageError as in `load_config`."""
    return _validated(_merge(config.model_dump(), overrides), "")


def _validated(settings: dict[str, Any], where: str) -> Config:
    try:
        return Config.model_validate(settings)
    except ValidationError as error:
        raise UsageError(
            f"{where}{_complaint(error.errors()[0])}; "
            "run `specmap config` to see every key and its default"
        ) from None


def _complaint(finding: Mapping[str, Any]) -> str:
    """One finding of a validation: the key, what is wrong, what was found."""
    key = ".".join(str(part) for part in finding["loc"])
    if finding["type"] == "extra_forbidden":
        near = difflib.get_close_matches(key, _keys(Config()), 1)
        return f"{key}: no such setting" + (f", did you mean {near[0]}?" if near else "")
    if finding["type"] == "model_type":
        return f"{key}: is a section: expected one of its keys, found {finding['input']!r:.60}"
    prefix = f"{key}: " if key else ""
    found = "" if isinstance(finding["input"], dict) else f", found {finding['input']!r:.60}"
    return f"{prefix}{finding['msg']}{found}"


def _keys(config: Config) -> list[str]:
    """Every key of the configuration, dotted."""
    keys = []
    for name, value in config.model_dump().items():
        keys += [f"{name}.{key}" for key in value] if isinstance(value, dict) else [name]
    return keys


def _merge(base: dict[str, Any], over: dict[str, Any]) -> dict[str, Any]:
    """A nested dictionary with the entries of `over` in place of those of `base`."""
    merged = dict(base)
    for key, value in over.items():
        both = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both else value
    return merged
