"""Every setting and its default, on one page, a section a stage.

A setting is what somebody with another robot, sensor or building would turn. What is nobody's to
turn is a constant beside its use, and what was a setting once is in `core/retired.toml`.
`specmap config` prints the settings with the values in force; how files, presets and flags change
them is in `core/config.py`.
"""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from specmap_cli.core.schemas import Described


class _Section(Described, BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LogConfig(_Section):
    """Which messages are read, how large they may be, which part of a cloud becomes planar."""

    scan_topic: str | None = None
    """Topic of the scans, where several fit."""
    scan_frame: str | None = None
    """Frame of the scans, where several lasers share a topic."""
    odom_topic: str | None = None
    """Topic of the odometry, where several fit."""
    base_frame: str | None = None
    """Frame of the robot's base, where it is not found."""
    use_odometry: bool = True
    """Whether odometry is read; false: scans alone place the robot."""
    unpacked_max_gb: float = Field(50.0, gt=0)
    """Largest temporary copy of a file that is compressed as a whole."""
    chunk_max_mb: float = Field(128.0, gt=0)
    """Largest chunk or message that is read; several may be in memory at once."""
    transform_messages: int = Field(50_000, ge=1)
    """Most messages of each kind that are searched for the laser's place on the base."""
    band_min_m: float = 0.15
    """Lower end of the heights above the floor that a 3D cloud is cut to."""
    band_max_m: float = 1.5
    """Upper end of the heights above the floor that a 3D cloud is cut to."""

    @model_validator(mode="after")
    def _band_has_height(self) -> LogConfig:
        if self.band_min_m >= self.band_max_m:
            raise ValueError("band_min_m must be below band_max_m")
        return self


class KeyframeConfig(_Section):
    """When a scan goes on to mapping and training."""

    distance_m: float = Field(0.05, gt=0)
    """Motion since the last keyframe that makes a scan the next one."""
    angle_rad: float = Field(0.0524, gt=0)
    """Turn since the last keyframe that makes a scan the next one: 3 degrees."""


class RegistrationConfig(_Section):
    """The front end: each scan registered on a window of keyframes, checked and bounded."""

    method: str = "kiss-icp"
    """How scans are aligned; installed packages can add methods."""
    min_range_m: float = Field(0.05, ge=0)
    """Nearer returns are the robot itself and are left out."""
    max_range_m: float = Field(20.0, gt=0)
    """Farther returns of planar scans are left out."""
    voxel_m: float = Field(0.1, ge=0.01)
    """Cell of the local map of planar scans; kernels and score fields scale with it."""
    min_points: int = Field(10, ge=3)
    """Scans with fewer wall points are placed by odometry, or lost."""
    cloud_range_m: float = Field(40.0, gt=0)
    """Farther returns of 3D clouds are left out."""
    cloud_voxel_m: float = Field(0.2, ge=0.01)
    """Cell of the local map of 3D clouds; a larger one is quicker."""
    level_share: float = Field(0.2, ge=0, le=1)
    """Share of a 3D lidar's roll and pitch taken back at every scan; 0 for ramps."""
    carried_forward_m: float = Field(0.5, ge=0)
    """Longest motion between scans that is carried on until walls have confirmed a longer one."""
    carried_sideways_m: float = Field(0.2, ge=0)
    """Longest sideways motion between scans that is carried on until walls have confirmed a longer
    one."""
    carried_rad: float = Field(0.8, ge=0)
    """Largest turn between scans that is carried on until walls have confirmed a larger one."""
    odometry_jump_m: float = Field(2.0, ge=0)
    """Longest step of the odometry that is no reset; odometry_jump_mps adds to it."""
    odometry_jump_mps: float = Field(3.0, ge=0)
    """Metres that a step of the odometry may be longer, for each second, before it is a reset."""
    max_shift_m: float = Field(1.5, gt=0)
    """Alignments that end farther from their guess are refused."""
    max_shift_rad: float = Field(0.8, gt=0)
    """Alignments that are turned further from their guess are refused."""
    max_tilt_rad: float = Field(0.3, gt=0, lt=1.5)
    """Alignments that tilt the robot more are refused; more for steep ramps."""


class GridConfig(_Section):
    """The occupancy grid of a submap."""

    resolution_m: float = Field(0.05, ge=0.005, le=1.0)
    """Side of a cell of the grids."""
    max_range_m: float = Field(20.0, gt=0)
    """Beams are cut at this range and prove no obstacle there."""
    footprint_m: float = Field(0.2, ge=0, le=5)
    """Radius of the robot, which is free space where it stood."""
    max_extent_m: float = Field(1000.0, gt=0)
    """Longest side that a grid may have."""
    max_area_m2: float = Field(100_000.0, gt=0)
    """Largest area that a grid may have."""


class SegmentationConfig(_Section):
    """Section II of the paper. docs/segmentation.md says what each choice is for."""

    cell_m: float = Field(0.05, ge=0.01, le=1.0)
    """Cells of the working grid; coarser ones tip borders."""
    obstacle_m: float = Field(1.5, ge=0)
    """Isolated obstacles up to this size count as free space."""
    furniture_m: float = Field(2.5, ge=0)
    """Solid isolated obstacles up to this size count as free space, too."""
    wide_door_m: float = Field(2.5, ge=0)
    """Openings in the line of a wall up to this width divide rooms as doors do; 0: narrow ones
    alone."""
    fill: bool = True
    """Whether the cells of furniture take the label of their room."""
    nodes: Literal["clearest", "centre"] = "clearest"
    """Which cell of a block becomes its node."""
    node_step_m: float = Field(0.7, gt=0, le=10)
    """Side of a block, which has one node."""
    clearance_m: float = Field(0.25, ge=0)
    """Nodes and sight lines keep this far off walls."""
    sight_m: float = Field(5.0, gt=0)
    """Longest sight line between two nodes; longer for long corridors."""
    neighbours: int = Field(0, ge=0)
    """Number l of neighbours in eq. 1; 0: all visible nodes."""
    eigenvalue_min: float = Field(0.75, gt=0, lt=1)
    """Least eigenvalue that counts as a cluster."""
    part_nodes: int = Field(4000, ge=16)
    """Graphs with more nodes are first cut at their narrowest places."""
    halve: bool = True
    """Whether each cluster is searched for two clusters again."""
    halve_eigenvalue: float = Field(0.7, gt=0, lt=1)
    """Second eigenvalue of a cluster above which it is halved."""
    labels: Literal["flood", "nearest"] = "flood"
    """How free cells get the label of a node."""
    merge: bool = True
    """Whether clusters are joined whose border is as wide as they are."""
    merge_ratio: float = Field(0.72, gt=0)
    """Width of a border, as a share of the room's, that joins clusters."""
    placements: int = Field(5, ge=1, le=16)
    """Number of divisions with other nodes; what most of them say counts."""
    rooms_only: bool = True
    """Whether `segment` leaves out free space that no robot could enter."""
    test_every: Literal["metres", "keyframes"] = "metres"
    """Whether tests for a new submap go by metres or by keyframes."""
    test_keyframes: int = Field(50, ge=1)
    """Keyframes between two tests that go by keyframes."""
    split_eigenvalue: float = Field(0.6, gt=0, lt=1)
    """Eigenvalue that parts the way, in a test for a new submap, above which it is split off."""
    split_share: float = Field(0.1, ge=0, lt=0.5)
    """Least share of the way on each side of a split."""
    split_scale: float = Field(3.0, gt=0)
    """Sigma of eq. 1 in a test for a new submap, as a multiple of its median."""
    split_obstacle_m: float = Field(1.0, ge=0)
    """Isolated obstacles up to this size count as free space in a test for a new submap."""
    split_clearance_m: float = Field(0.3, ge=0)
    """Nodes and sight lines keep this far off walls in a test for a new submap."""
    split_sight_m: float = Field(1000.0, gt=0)
    """Longest sight line between two nodes in a test for a new submap."""
    path_band_m: float = Field(2.0, ge=0)
    """Nodes of a test for a new submap lie this near to the path; 0: anywhere."""
    region_min_m: float = Field(1.0, ge=0)
    """Shortest way that is split off, or goes on as a region of its own."""
    regrow: bool = True
    """Whether a region that the robot comes straight back to goes on."""
    final_regions: bool = True
    """Whether submaps end where the regions of the finished map do."""


class RecognitionConfig(_Section):
    """Section III of the paper: features, boosting, loop closure."""

    feature_set: str = "full"
    """Set of features of raw scans; installed packages can add sets."""
    booster: Literal["trees", "stumps"] = "trees"
    """Kind of the weak classifiers; stumps are the paper's own."""
    rounds: int = Field(200, ge=1)
    """Number of weak classifiers of a submap's final classifier."""
    positives: int = Field(500, ge=10)
    """Most scans of its own submap that a classifier learns from."""
    negatives: int = Field(3000, ge=10)
    """Most scans of other submaps that a classifier learns from."""
    augmentation: int = Field(150, ge=0)
    """Submaps of fewer scans get so many, some as seen from beside the way."""
    closure_rounds: int = Field(30, ge=1)
    """Number of weak classifiers while old submaps are ranked."""
    closure_negatives: int = Field(400, ge=10)
    """Most scans of other submaps while old submaps are ranked."""
    groups: int = Field(3, ge=0)
    """Number of held-out groups of old submaps; 0: one by one."""
    refresh_growth: float = Field(0.4, ge=0)
    """Growth of the submaps after which classifiers learn anew."""
    xi_threshold: float = Field(0.175, ge=0, le=1)
    """Least xi of eq. 5 that closes a loop without `verify`."""
    verify: bool = True
    """Whether a closure needs a match of the two grids."""
    stays_kept: int = Field(16, ge=1)
    """Most visits of a submap that are remembered: those that saw most."""
    min_score: float = Field(0.75, le=1)
    """Least score of a match: inliers less twice the contradictions."""
    max_drift: float = Field(0.1, ge=0)
    """Metres per metre driven that a closure may mend."""


class RelaxationConfig(_Section):
    """The layout of the submaps: a pose graph over the keyframes."""

    enabled: bool = True
    """Whether the layout is relaxed; false: the path stays as tracked."""
    follow_walls: bool = True
    """Whether the map's axes lie along the walls, else along the robot's first pose."""


class WaysConfig(_Section):
    """Doors between submaps, places to stand, and ways for a robot from one to another."""

    robot_radius_m: float = Field(0.2, gt=0, le=5)
    """Radius of the robot: ways keep this off walls and off what nobody saw."""
    door_min_m: float = Field(0.5, gt=0)
    """Narrower gaps are no doors: those of buildings are 0.6 m and more."""


class LocalizationConfig(_Section):
    """The hidden Markov filter over the topology, and virtual scans."""

    virtual: bool = True
    """Whether virtual full-circle scans over the last metres are labelled."""
    feature_set: str = "places"
    """Set of features of virtual scans; installed packages can add sets."""
    track_samples: int = Field(800, ge=1)
    """Virtual scans along the track that classifiers learn from."""
    augmentation: int = Field(1500, ge=0)
    """Virtual scans from free cells that classifiers learn from."""
    stay: float = Field(0.95, gt=0, lt=1)
    """Chance to stay in a submap from view to view."""
    unknown: bool = True
    """Whether scans may get the label unknown."""
    false_unknown: float = Field(0.05, gt=0, lt=1)
    """Share of the scans of known places that are given up."""
    least_misfit: float = Field(0.05, gt=0, le=1)
    """Share of returns off the walls that is usual in known places: people pass, doors move."""
    lead: float = Field(0.95, gt=0.5, lt=1)
    """Chance of a place from which on its pose is given."""


class UpdateConfig(_Section):
    """What an update keeps of the recordings that the map was made of; docs/update.md."""

    keep_all: bool = False
    """Whether older keyframes stay where newer ones show the same."""


class LimitsConfig(_Section):
    """How large a file of a map may be: a small one may swell, a wrong one may never end."""

    text_max_mb: float = Field(268.0, gt=0)
    """Largest JSON, CSV or features file of a map: a hundred submaps take a tenth."""
    picture_max_mpixel: float = Field(100.0, gt=0)
    """Largest picture in millions of pixels: 500 m by 500 m at 0.05 m."""
    keyframes_max_mb: float = Field(2000.0, gt=0)
    """Largest file of a map's scans: a day's drive takes a tenth."""


class Config(_Section):
    """All settings of a run."""

    preset: Literal["default", "paper"] = "default"
    """The preset that the other settings were changed from."""
    seed: int = Field(0, ge=0)
    """Seed of all that is drawn at random."""
    log: LogConfig = LogConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    registration: RegistrationConfig = RegistrationConfig()
    grid: GridConfig = GridConfig()
    segmentation: SegmentationConfig = SegmentationConfig()
    recognition: RecognitionConfig = RecognitionConfig()
    relaxation: RelaxationConfig = RelaxationConfig()
    ways: WaysConfig = WaysConfig()
    localization: LocalizationConfig = LocalizationConfig()
    update: UpdateConfig = UpdateConfig()
    limits: LimitsConfig = LimitsConfig()
