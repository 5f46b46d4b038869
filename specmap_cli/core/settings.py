"""Every setting and its default, on one page, a section a stage.

Each says its unit and its reason. `specmap config` prints them with the values in force; how files,
presets and flags change them is in `core/config.py`.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator


class _Section(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LogConfig(_Section):
    """Which messages are read, how long one waits for another, how a cloud becomes planar."""

    scan_topic: str | None = Field(None, description="topic of the scans, where several fit")
    odom_topic: str | None = Field(None, description="topic of the odometry, where several fit")
    base_frame: str | None = Field(None, description="the robot's base, where it is not found")
    use_odometry: bool = Field(True, description="false: read no odometry at all")
    unpacked_max_gb: float = Field(
        50.0, gt=0, description="temporary copy of a file that is compressed as a whole"
    )
    unpacked_ratio_max: float = Field(
        500.0, ge=1, description="its swelling from 100 MB on: a log does not, a bomb does"
    )
    chunk_max_mb: float = Field(
        128.0, gt=0, description="one chunk or message; several may be in memory at once"
    )
    tried_messages: int = Field(
        50, ge=1, description="of a topic, in search of one that can be read; then it is refused"
    )
    transform_messages: int = Field(
        50_000, ge=1, description="of each kind, in search of the laser's place on the base"
    )
    tilt_max_rad: float = Field(
        0.175, ge=0, le=1.5708, description="a laser tilted more is warned of: it is read as level"
    )
    odometry_wait_scans: int = Field(
        4, ge=0, description="a scan waits for later odometry until more scans than this wait"
    )
    odometry_wait_s: float = Field(0.5, ge=0, description="nor longer than this, by log time")
    odometry_gap_s: float = Field(
        2.0, gt=0, description="poses farther apart are not interpolated between"
    )
    odometry_hold_s: float = Field(
        0.1, ge=0, description="the first and the last pose hold so long before and after it"
    )
    clock_reset_s: float = Field(
        10.0, gt=0, description="odometry stamped so far back means that the clock was set back"
    )
    scan_time_max_s: float = Field(
        1.0, gt=0, description="a planar sweep that takes longer has its times in another unit"
    )
    cloud_time_max_s: float = Field(
        10.0, gt=0, description="times of points farther from the stamp are of no use"
    )
    band_min_m: float = Field(0.15, description="height above the base's floor, lower end")
    band_max_m: float = Field(1.5, description="upper end")
    floor_radius_m: float = Field(
        10.0, gt=0, description="a floor of unknown height is sought among the returns this near"
    )
    floor_percentile: float = Field(
        2.0, ge=0, le=100, description="of their heights: a few stray returns lie below the floor"
    )
    cloud_beams: int = Field(720, ge=16, description="bearings of the planar scan of a 3D cloud")
    cloud_filled_share: float = Field(
        0.9, gt=0, le=1, description="of the bearings must have returns, or they are halved"
    )
    cloud_range_max_m: float = Field(100.0, gt=0, description="a 3D cloud is cut here")

    @model_validator(mode="after")
    def _band_has_height(self) -> LogConfig:
        if self.band_min_m >= self.band_max_m:
            raise ValueError("band_min_m must be below band_max_m")
        return self


class KeyframeConfig(_Section):
    """When a scan goes on to mapping and training."""

    distance_m: float = Field(0.05, gt=0, description="motion since the last keyframe that counts")
    angle_rad: float = Field(0.0524, gt=0, description="or turn since then: 3 degrees")


class RegistrationConfig(_Section):
    """The front end: each scan registered on a window of keyframes, checked and bounded."""

    method: str = Field("kiss-icp", description="how scans are aligned; packages can add methods")
    # points
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
    # the local map
    window_keyframes: int = Field(80, ge=1, description="keyframes in the local map")
    keyframe_m: float = Field(0.3, gt=0, description="motion between keyframes of the local map")
    keyframe_rad: float = Field(0.25, gt=0, description="turn between them")
    points_per_voxel: int = Field(20, ge=1, description="most points kept in a voxel; 10 is faster")
    rebuild_keyframes: int = Field(
        4, ge=1, description="keyframes between rebuilds of the voxels, which forget older ones"
    )
    field_ranges: float = Field(
        2.0, ge=1, le=20, description="side of the score field, in ranges; walls beyond score 0"
    )
    # the guess
    guess_margin: float = Field(
        0.05, ge=0, le=1, description="score by which steady motion must beat odometry as the guess"
    )
    carried_forward_m: float = Field(
        0.5, ge=0, description="longest motion carried on from the scan before, which may be wrong"
    )
    carried_sideways_m: float = Field(0.2, ge=0, description="its longest part to the side")
    carried_rad: float = Field(0.8, ge=0, description="its largest turn")
    odometry_jump_m: float = Field(
        2.0, ge=0, description="an odometry increment beyond this and odometry_jump_mps is a reset"
    )
    odometry_jump_mps: float = Field(3.0, ge=0, description="metres more for each second between")
    # the alignment, and the searches when it is doubted
    iterations: int = Field(50, ge=1, description="of the registration, per kernel")
    kernel_voxels: tuple[Annotated[float, Field(gt=0)], ...] = Field(
        (2.0, 1.0, 0.5, 0.25),
        min_length=1,
        description="widths of the robust kernel, in voxels, coarse to fine",
    )
    max_shift_m: float = Field(
        1.5, gt=0, description="an alignment that ends farther from its guess is refused"
    )
    max_shift_rad: float = Field(
        0.8, gt=0, description="an alignment turned further from its guess is refused"
    )
    max_tilt_rad: float = Field(
        0.3, gt=0, lt=1.5, description="one that tilts the robot more is refused: steep ramps"
    )
    good_score: float = Field(0.75, ge=0, le=1, description="up to this score a search is made")
    doubt_m: float = Field(0.15, gt=0, description="or when the result is this far from its guess")
    doubt_rad: float = Field(0.1, gt=0, description="or turned this far")
    search_m: float = Field(
        0.25, ge=0, le=20, description="half width of the search: odometry's error"
    )
    search_rad: float = Field(
        0.35, ge=0, le=3.1416, description="its half angle: a clock apart, in a turn"
    )
    blind_search_m: float = Field(0.3, ge=0, le=20, description="as search_m, without odometry")
    blind_search_rad: float = Field(
        0.5, ge=0, le=3.1416, description="as search_rad, without odometry"
    )
    poor_score: float = Field(0.5, ge=0, le=1, description="below it the wide search is made, too")
    wide_search_m: float = Field(1.0, ge=0, le=20, description="its half width: a hole in the log")
    wide_search_rad: float = Field(1.6, ge=0, le=3.1416, description="its half angle")
    slip_m: float = Field(
        0.08, ge=0, description="a result this far behind odometry may have slipped in a corridor"
    )
    # the judgement; a result against the expected motion needs poor_score at the least
    sure_score: float = Field(
        0.7, ge=0, le=1, description="needed against odometry once a search was made, or it is lost"
    )
    fair_score: float = Field(0.6, ge=0, le=1, description="as sure_score, without odometry")
    believed_step_m: float = Field(
        0.5, gt=0, description="from this motion between scans on, it proves no result right"
    )
    believed_step_rad: float = Field(0.5, gt=0, description="from this turn on likewise")
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
    split_eigenpairs: int = Field(
        12, ge=2, description="looked at in a test: each room seen but not entered takes one"
    )
    split_step_m: float = Field(0.15, ge=0, description="motion between scans in a test's map")
    split_step_rad: float = Field(0.2, ge=0, description="or turn between them")
    path_band_m: float = Field(2.0, ge=0, description="nodes lie this near the path; 0: anywhere")
    path_margin_m: float = Field(
        1.0, ge=0, description="map kept round the band: obstacles at its edge are seen whole"
    )
    region_min_m: float = Field(1.0, ge=0, description="shortest way that is split off or goes on")
    regrow: bool = Field(True, description="a region the robot comes straight back to goes on")
    regrow_keyframes: int = Field(
        150, ge=10, description="of both pieces, mapped to see whether they are one region"
    )
    final_regions: bool = Field(True, description="submaps end where the finished map's do")


class RecognitionConfig(_Section):
    """Section III of the paper: features, boosting, loop closure."""

    feature_set: str = Field("full", description="of raw scans; packages can add sets")
    booster: Literal["trees", "stumps"] = Field("trees", description="stumps: the paper's own")
    rounds: int = Field(200, ge=1, description="weak classifiers of a submap's final classifier")
    shrinkage: float = Field(0.5, gt=0, le=1, description="trees: scale of every vote")
    feature_share: float = Field(0.2, gt=0, le=1, description="trees: features drawn a round")
    negatives: int = Field(1500, ge=10, description="scans of other submaps a classifier sees")
    closure_rounds: int = Field(30, ge=1, description="weak classifiers while ranking")
    closure_shrinkage: float = Field(0.5, gt=0, le=1, description="as shrinkage, while ranking")
    closure_negatives: int = Field(400, ge=10, description="as negatives, while ranking")
    samples_per_submap: int = Field(100, ge=1, description="scans of a submap used for ranking")
    groups: int = Field(3, ge=0, description="held-out groups of old submaps; 0 = one by one")
    refresh_growth: float = Field(0.4, ge=0, description="retrain once the submaps grew by this")
    xi_threshold: float = Field(0.175, ge=0, le=1, description="eq. 5, judge without `verify`")
    verify: bool = Field(True, description="a closure needs a match of the two grids")
    candidates: int = Field(3, ge=1, description="best ranked old submaps whose grids are matched")
    leftovers: int = Field(2, ge=0, description="pairs matched a submap in search of duplicates")
    members: int = Field(2, ge=1, description="visits of an old submap whose grids are matched")
    match_cell_m: float = Field(
        0.2, ge=0.02, description="two grids are first matched on cells of about this side"
    )
    hopeless_score: float = Field(0.3, le=1, description="a match below this is given up")
    sure_score: float = Field(0.8, le=1, description="a match above this needs no other rotation")
    match_sigma_m: float = Field(0.15, gt=0, description="how near matched walls pull each other")
    inlier_m: float = Field(0.15, gt=0, description="a wall point this near a wall agrees")
    contradiction_m: float = Field(
        0.3, gt=0, description="one farther than this from walls, and in free space, contradicts"
    )
    contradiction_depth_m: float = Field(
        0.25, ge=0, description="free space counts this far from its edge, which noise blurs"
    )
    min_score: float = Field(0.75, le=1, description="inliers less twice the contradictions")
    min_lead: float = Field(0.1, ge=0, description="over the next best match, or it is ambiguous")
    min_wall_m: float = Field(5.0, ge=0, description="metres of wall that agree, cell by cell")
    min_overlap: float = Field(0.4, ge=0, le=1, description="shared part of one's walls")
    least_overlap: float = Field(0.15, ge=0, le=1, description="shared part of the other's walls")
    merge_overlap: float = Field(0.4, ge=0, le=1, description="of both tracks, for a merge")
    merge_reach_m: float = Field(1.0, gt=0, description="tracks this close overlap")
    max_drift: float = Field(
        0.1, ge=0, description="metres per metre driven that a closure may mend"
    )
    twin_margin_m: float = Field(
        1.5, ge=0, description="and metres besides; a match that mends more is of twin rooms"
    )


class RelaxationConfig(_Section):
    """The layout of the submaps: a pose graph over the keyframes."""

    enabled: bool = True
    node_m: float = Field(0.3, gt=0, description="motion between nodes of the pose graph")
    node_rad: float = Field(0.25, gt=0, description="turn between them")
    step_share: float = Field(0.03, gt=0, description="error of a motion, metres per metre driven")
    turn_share: float = Field(0.02, gt=0, description="error of its turn, radians per radian")
    guess_m: float = Field(
        0.3, gt=0, description="error of a motion without a wall in sight, or over a break"
    )
    guess_rad: float = Field(0.2, gt=0, description="the same of its turn")
    range_noise_m: float = Field(
        0.1, gt=0, description="error of a reading; more than the laser's: neighbours err alike"
    )
    match_range_m: float = Field(12.0, gt=0, description="farther returns are not matched")
    match_points: int = Field(20, ge=3, description="walls with fewer points are not matched")
    loop_every_m: float = Field(1.0, gt=0, description="path between searches for nearby passes")
    loop_path_m: float = Field(6.0, gt=0, description="less path than this between is no pass")
    loop_radius_m: float = Field(3.0, gt=0, description="how near a pass must be")
    loops_per_node: int = Field(2, ge=0, description="passes matched at the most, 0: none")
    loop_score: float = Field(0.6, ge=0, le=1, description="a match below this is no edge")
    loop_search_m: float = Field(0.3, gt=0, description="a pass is searched this far at the least")
    loop_search_max_m: float = Field(2.0, gt=0, description="and this far at the most")
    drift_share: float = Field(
        0.04, ge=0, description="metres per metre driven by which a layout with passes may be off"
    )
    stray_tries: int = Field(
        30, ge=0, description="searches to rejoin a piece of the path after tracking was lost"
    )
    stray_votes: int = Field(3, ge=1, description="finds that must agree on where the piece lies")
    stray_cells: int = Field(
        512, ge=16, description="cells a side in such a search: a larger map is searched coarser"
    )
    closure_sigma_m: float = Field(
        0.04, gt=0, description="spread of matched grids' transforms about the truth, x and y"
    )
    closure_sigma_rad: float = Field(0.0087, gt=0, description="the same of their heading")
    closure_slack_m: float = Field(0.5, ge=0, description="what any closure may mend")
    closure_drift_share: float = Field(
        0.15, ge=0, description="and per metre driven between its ends, where no pass cuts it short"
    )
    kernel_sigmas: float = Field(
        2.0, gt=0, description="closures and passes farther off than this pull less and less"
    )
    outlier_chi2: float = Field(
        25.0, gt=0, description="above it, five sigmas off, they are dropped in the end"
    )
    solve_every: int = Field(12, ge=1, description="edges found before the layout is renewed")
    solve_iterations: int = Field(20, ge=1, description="steps of the solver at the most")

    @model_validator(mode="after")
    def _searches_have_a_range(self) -> RelaxationConfig:
        if self.loop_search_m > self.loop_search_max_m:
            raise ValueError("loop_search_m must not be above loop_search_max_m")
        return self


class LocalizationConfig(_Section):
    """The hidden Markov filter over the topology, and virtual scans."""

    virtual: bool = Field(True, description="virtual full-circle scans over the last metres")
    feature_set: str = Field("places", description="of virtual scans; packages can add sets")
    window_m: float = Field(10.0, gt=0, description="path whose scans make a virtual scan")
    virtual_beams: int = Field(360, ge=16, description="bearings of a virtual scan")
    virtual_range_m: float = Field(20.0, gt=0, description="farther returns are not in it")
    virtual_spacing_m: float = Field(0.2, ge=0, description="motion between the scans in it")
    virtual_spacing_rad: float = Field(0.3, ge=0, description="or turn between them")
    raw_weight: float = Field(0.1, ge=0, le=1, description="of the single scan; 1 at the start")
    track_samples: int = Field(800, ge=1, description="virtual scans along the track, training")
    augmentation: int = Field(1500, ge=0, description="virtual scans from free cells, training")
    augmentation_reach_m: float = Field(
        1.5, gt=0, description="such cells lie this near the track: farther, much was never seen"
    )
    augmentation_clearance_m: float = Field(
        0.25, ge=0, description="and this far from walls, as a robot does"
    )
    stay: float = Field(
        0.97, gt=0, lt=1, description="chance to stay in a submap from scan to scan"
    )
    leap: float = Field(
        1e-4, gt=0, lt=0.5, description="chance to be anywhere next, by a way that was never driven"
    )
    leave: float = Field(1e-4, ge=0, lt=0.5, description="chance to leave the map, or to come back")
    sharpness: float = Field(0.1, gt=0, description="scale of margins in the filter")
    unknown: bool = Field(True, description="allow the label unknown")
    false_unknown: float = Field(0.05, gt=0, lt=1, description="share of known scans given up")
    exemplars: int = Field(80, ge=1, description="scans kept of a submap, to tell unknown ones by")
    strange_alone: float = Field(
        1.2, gt=0, description="a single scan is unknown beyond this share of the limit"
    )
    strange_from: float = Field(
        0.87, gt=0, description="from this share of the limit on, a scan speaks for unknown"
    )
    view_slack_rad: float = Field(
        0.0873, ge=0, description="a laser is refused that sees by more than this less"
    )
    range_share: float = Field(
        0.5, ge=0, le=1, description="or that sees less far than this share of the map's laser"
    )
    follow_m: float = Field(
        0.4, gt=0, description="a pose in a submap is sought this near where motion says it is"
    )
    follow_rad: float = Field(0.2094, gt=0, description="and turned this much")
    lost_score: float = Field(0.55, ge=0, le=1, description="below it the whole submap is searched")


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
