"""The commands about recordings: info, convert, simulate; evaluate, of what was made of them."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from specmap_cli.cli.options import (
    RECORDING,
    Bounds,
    Common,
    Logs,
    LogSettings,
    Overwrite,
    Resolution,
    argument,
    check_files,
    option,
    output,
)
from specmap_cli.core.errors import UsageError

if TYPE_CHECKING:
    from specmap_cli.core.settings import Config
    from specmap_cli.evaluation.protocols import ClassificationScores


def info(
    logs: Logs,
    settings: LogSettings,
    common: Common,
    check: Annotated[
        bool, option("Read every message, and compare with the counts of the recording.", "--check")
    ] = False,
) -> None:
    """Show what a recording holds, and what to run next.

    Topics with their types, counts and rates, the duration, the frames, the scans, and what
    `specmap build` would read with the same options. Only the beginning is read. --check reads the
    recording to its end: for each topic it shows how many of its messages can be read, where they
    pause, and how many stamps step back.

    \b
    specmap info log.mcap
    specmap info recording_directory --json
    specmap info log.mcap --check
    """
    from specmap_cli.logs import open_log
    from specmap_cli.logs.inspection import summarize

    effective = settings.load()
    with open_log(logs, effective.log) as log, common.progress() as progress:
        summary = summarize(log, effective.log, complete=check, progress=progress)
    common.show(summary.to_dict(), summary.lines())


_OTHERS = frozenset({".bag", ".db3", ".log", ".clf", ".gz"})  # names of recordings of other kinds


def convert(
    paths: Annotated[
        list[Path], argument("LOG", f"{RECORDING} Without --out the last one is the MCAP to write.")
    ],
    out: Annotated[Path | None, output("MCAP to write.")] = None,
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Convert a recording of another format to MCAP.

    A CARMEN log, ROS 1 bag or rosbag2 recording becomes an MCAP of ROS 2 messages. Keeps scans,
    point clouds, odometry and transforms; says what it left out. Of the settings, those that bound
    what is unpacked count, such as log.chunk_max_mb.

    \b
    specmap convert log.bag -o log.mcap
    specmap convert log.bag log.mcap
    """
    from specmap_cli.logs.writer import convert as convert_log

    logs, target = (paths, out) if out is not None else (paths[:-1], paths[-1])
    if not logs:
        raise UsageError(f"name the MCAP to write: specmap convert {target} -o OUT.mcap")
    check_files([target], logs, common, overwrite=overwrite)
    if target.suffix.lower() in _OTHERS:
        raise UsageError("what is written is an MCAP", "name it so: OUT.mcap", where=target)
    bounds = settings.load().log
    with common.progress() as progress:
        conversion = convert_log(
            logs, target, overwrite=overwrite, progress=progress, config=bounds
        )
    common.show({**asdict(conversion), "path": str(target)}, conversion.lines())


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulated:
    """The options of the laser, then of the robot and its tour, as in `SimulationOptions`."""

    field_of_view_deg: Annotated[float, option("Field of view, degrees.", "--fov")] = 270.0
    beams: Annotated[int, option("Beams a scan.")] = 541
    range_max_m: Annotated[float, option("Longest range, metres.", "--range")] = 20.0
    rate_hz: Annotated[float, option("Scans a second.", "--rate")] = 10.0
    sweep_s: Annotated[
        float, option("Seconds from a scan's first beam to its last.", "--sweep")
    ] = 0.0
    noise_m: Annotated[float, option("Standard deviation of a range, metres.", "--noise")] = 0.01
    dropouts: Annotated[float, option("Share of beams that return nothing.")] = 0.0
    rings: Annotated[int, option("Of a 3D lidar, each of so many beams. 1: a planar laser.")] = 1
    vertical_fov_deg: Annotated[
        float, option("3D: lowest ring to highest, degrees.", "--vertical-fov")
    ] = 45.0
    laser_height_m: Annotated[
        float, option("3D: lidar above the floor, metres.", "--laser-height")
    ] = 0.6
    ceiling_m: Annotated[
        float, option("3D: walls and ceiling above the floor, metres.", "--ceiling")
    ] = 2.5
    speed_mps: Annotated[float, option("Metres a second.", "--speed")] = 0.6
    odometry_drift: Annotated[
        float, option("Errors of the odometry: 0 exact, 1 a usual robot.")
    ] = 1.0
    spacing_m: Annotated[
        float, option("The path comes this near to every place, metres.", "--spacing")
    ] = 2.0
    laps: Annotated[int, option("Tours, each by another route.")] = 1
    max_duration_s: Annotated[
        float | None, option("End the recording after so many seconds.", "--max-duration")
    ] = None
    seed: Annotated[int, option("Another seed, another route and other errors.")] = 0


def simulate(
    context: typer.Context,
    plan: Annotated[
        Path, argument("PLAN", "Floor plan: map_server .yaml, or .png with --resolution.")
    ],
    out: Annotated[Path, output("MCAP to write; the true poses go beside it, as .tum.")],
    resolution: Resolution = None,
    overwrite: Overwrite = False,
    *,
    simulated: Simulated,
    settings: Bounds,
    common: Common,
) -> None:
    """Record a simulated robot that tours a floor plan.

    A robot with a planar laser drives through all space it can reach. Writes an MCAP with /scan,
    /odom and /tf_static, and the true poses beside it as .tum. With --rings it has a 3D lidar, and
    /points in place of /scan. Of the settings only the section `limits` counts: how large the
    picture of the plan may be.

    \b
    specmap simulate plan.yaml -o tour.mcap --laps 2
    specmap simulate plan.png --resolution 0.05 -o tour.mcap --fov 360 --beams 720
    specmap simulate plan.yaml -o tour.mcap --fov 360 --rings 64 --beams 1024
    """
    from specmap_cli.grids.map_server import files_of_grid, read_grid
    from specmap_cli.pipelines.simulate import simulate as record
    from specmap_cli.simulation.simulator import simulation_options

    limits = settings.load().limits
    try:
        options = simulation_options(**asdict(simulated))
    except UsageError as error:
        names = {one.name: one.opts[0] for one in context.command.params}
        raise UsageError(error.found, where=names.get(error.where or "")) from None
    truth = out.parent / f"{out.stem}.tum"
    check_files([out, truth], files_of_grid(plan), common, overwrite=overwrite)
    with common.progress() as progress:
        floor = read_grid(plan, resolution, limits, progress)
        made = record(floor, options, out, truth, progress)
    common.show(made.as_dict(), made.lines())


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What is evaluated: one of these."""

    protocol: Annotated[
        Literal["holdout", "revisit"] | None,
        option(
            "holdout: label scans held out of the map (Table II of the paper); "
            "revisit: label another log (Figure 6)."
        ),
    ] = None
    baseline: Annotated[
        Literal["room-hallway"] | None,
        option("room-hallway: kinds of places instead of places (Figure 5c)."),
    ] = None
    trajectory: Annotated[
        Path | None, option("Trajectory to score, such as out/trajectory.tum.")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What is known to be true."""

    relations: Annotated[
        Path | None, option("True relative poses: t1 t2 x y z roll pitch yaw.")
    ] = None
    reference: Annotated[
        list[Path] | None,
        option("True poses, TUM. With two logs: of the first, then of the second."),
    ] = None
    rooms: Annotated[
        list[Path] | None,
        option(
            "room-hallway: picture of the rooms, white, its lower left corner the origin of "
            "the true poses; a second one when LOG2 is of another building."
        ),
    ] = None
    resolution: Annotated[float, option("Metres a pixel of --rooms.", min=0.001)] = 0.05

    @property
    def references(self) -> list[Path]:
        """The true poses given."""
        return self.reference or []

    @property
    def pictures(self) -> list[Path]:
        """The pictures of rooms given."""
        return self.rooms or []


@dataclass(frozen=True, slots=True, kw_only=True)
class Drawing:
    """How the scans of a hold-out are drawn, named as in `HoldOut`."""

    split: Annotated[Literal["random", "blocks"], option("How scans are held out.")] = "random"
    share: Annotated[float, option("Share held out.", min=0.01, max=0.9)] = 0.2
    block: Annotated[int, option("Scans of a block.", min=1)] = 100
    seed: Annotated[int, option("Seed of the split.", min=0)] = 0


class Found(NamedTuple):
    """The result of an evaluation; the scores of labels can be drawn."""

    figures: dict[str, Any]
    lines: list[str]
    scores: ClassificationScores | None = None


def evaluate(
    logs: Annotated[
        list[Path] | None,
        argument(
            "[LOG] [LOG2]",
            "holdout: a log. revisit: a log or its map directory, and the other log. "
            "room-hallway: the log to learn from, and the log to name.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        output("PNG of the confusion matrix to write (with --protocol).", "--confusion"),
    ] = None,
    overwrite: Overwrite = False,
    *,
    task: Task,
    truth: Truth,
    drawing: Drawing,
    settings: LogSettings,
    common: Common,
) -> None:
    """Score localisation or a trajectory against truth.

    --json gives the same figures as one object: of holdout {"train": {"recall", "precision",
    "scans", ...}, "test": {...}, "filtered": {...}, "submaps": [...]}.

    \b
    specmap evaluate log.mcap --protocol holdout
    specmap evaluate map log2.mcap --protocol revisit --reference log.tum --reference log2.tum
    specmap evaluate --trajectory map/trajectory.tum --reference log.tum
    """
    _need(
        sum(each is not None for each in (task.protocol, task.baseline, task.trajectory)) == 1,
        "say what to evaluate, and one thing only: LOG --protocol holdout, or LOG LOG2 "
        "--protocol revisit, or LOG LOG2 --baseline room-hallway, or --trajectory FILE.tum",
    )
    if out is not None and task.protocol is None:
        raise UsageError("--confusion (--out) is of --protocol", "leave it out here")
    inputs = [*(logs or []), *truth.references, *truth.pictures]
    check_files([out], inputs, common, overwrite=overwrite)
    effective = settings.load()
    if task.trajectory is not None:
        found = _score_trajectory(task.trajectory, truth)
    elif task.baseline is not None:
        found = _name_places(logs or [], truth, effective, common)
    elif task.protocol == "holdout":
        found = _hold_out(logs or [], drawing, effective, common)
    else:
        found = _revisit(logs or [], truth, effective, common)
    if out is not None and found.scores is not None:
        from specmap_cli.drawing.overview import render_confusion
        from specmap_cli.grids.map_server import write_png

        names = [str(id_) for id_ in found.scores.ids]
        write_png(out, render_confusion(found.scores.confusion, names, [*names, "unknown"]))
    common.show(found.figures, found.lines)


def _need(condition: bool, usage: str) -> None:
    if not condition:
        raise UsageError(usage)


def _score_trajectory(trajectory: Path, truth: Truth) -> Found:
    from specmap_cli.evaluation import trajectories
    from specmap_cli.maps.text_files import read_tum

    _need(
        (truth.relations is None) == (len(truth.references) == 1),
        "--trajectory needs one of --relations FILE and --reference FILE.tum",
    )
    poses = read_tum(trajectory)
    if truth.relations is not None:
        errors = trajectories.relation_errors(poses, trajectories.read_relations(truth.relations))
        return Found(asdict(errors), trajectories.relation_lines(errors))
    found = trajectories.reference_errors(poses, read_tum(truth.references[0]))
    return Found(found.as_dict(), trajectories.reference_lines(found))


def _hold_out(logs: list[Path], drawing: Drawing, config: Config, common: Common) -> Found:
    from specmap_cli.evaluation.protocols import HoldOut, hold_out, hold_out_lines

    _need(len(logs) == 1, "--protocol holdout needs one log: specmap evaluate LOG --protocol ...")
    with common.progress() as progress:
        result = hold_out(logs, config, HoldOut(**asdict(drawing)), progress)
    return Found(result.as_dict(), hold_out_lines(result), result.test)


def _revisit(logs: list[Path], truth: Truth, config: Config, common: Common) -> Found:
    from specmap_cli.evaluation.protocols import revisit_lines, revisit_logs

    references = truth.references
    _need(
        len(logs) == len(references) == 2,
        "--protocol revisit needs LOG LOG2 and --reference twice: the true poses of each",
    )
    with common.progress() as progress:
        result = revisit_logs(logs[0], logs[1], (references[0], references[1]), config, progress)
    return Found(result.as_dict(), revisit_lines(result), result.filtered)


def _name_places(logs: list[Path], truth: Truth, config: Config, common: Common) -> Found:
    from specmap_cli.evaluation.semantic import Labelled, room_hallway, semantic_lines
    from specmap_cli.simulation.worlds import read_rooms

    _need(
        len(logs) == len(truth.references) == 2 and len(truth.pictures) in (1, 2),
        "--baseline room-hallway needs LOG LOG2, --reference twice (the true poses of each) and "
        "--rooms once, or twice for two buildings",
    )
    plans = [read_rooms(picture, truth.resolution) for picture in truth.pictures]
    learned = Labelled(logs[0], truth.references[0], plans[0])
    asked = Labelled(logs[1], truth.references[1], plans[-1])
    with common.progress() as progress:
        result = room_hallway(learned, asked, config, progress)
    return Found(result.as_dict(), semantic_lines(result))
