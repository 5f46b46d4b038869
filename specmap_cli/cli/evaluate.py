"""`specmap evaluate`: scores of maps, labels and trajectories against truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple

import typer

from specmap_cli.cli.options import Common, LogSettings, Overwrite, check_files, output
from specmap_cli.core.errors import UsageError

if TYPE_CHECKING:
    from specmap_cli.core.settings import Config
    from specmap_cli.evaluation.protocols import ClassificationScores


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What is evaluated: one of these."""

    protocol: Annotated[
        Literal["holdout", "revisit"] | None,
        typer.Option(
            help="holdout: label scans held out of the map (Table II of the paper); "
            "revisit: label another log (Figure 6)."
        ),
    ] = None
    baseline: Annotated[
        Literal["room-hallway"] | None,
        typer.Option(help="room-hallway: kinds of places instead of places (Figure 5c)."),
    ] = None
    trajectory: Annotated[
        Path | None, typer.Option(help="Trajectory to score, such as out/trajectory.tum.")
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """What is known to be true."""

    relations: Annotated[
        Path | None, typer.Option(help="True relative poses: t1 t2 x y z roll pitch yaw.")
    ] = None
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="True poses, TUM. With two logs: of the first, then of the second."),
    ] = None
    rooms: Annotated[
        list[Path] | None,
        typer.Option(
            help="room-hallway: picture of the rooms, white, its lower left corner the origin of "
            "the true poses; a second one when LOG2 is of another building."
        ),
    ] = None
    resolution: Annotated[float, typer.Option(min=0.001, help="Metres a pixel of --rooms.")] = 0.05

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

    split: Annotated[Literal["random", "blocks"], typer.Option(help="How scans are held out.")] = (
        "random"
    )
    share: Annotated[float, typer.Option(min=0.01, max=0.9, help="Share held out.")] = 0.2
    block: Annotated[int, typer.Option(min=1, help="Scans of a block.")] = 100
    seed: Annotated[int, typer.Option(min=0, help="Seed of the split.")] = 0


class Found(NamedTuple):
    """The result of an evaluation; the scores of labels can be drawn."""

    figures: dict[str, Any]
    lines: list[str]
    scores: ClassificationScores | None = None


def evaluate(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[LOG] [LOG2]",
            help="holdout: a log. revisit: a log or its map directory, and the other log. "
            "room-hallway: the log to learn from, and the log to name.",
            show_default=False,
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
    from specmap_cli.evaluation.trajectories import (
        read_relations,
        reference_errors,
        reference_lines,
        relation_errors,
        relation_lines,
    )
    from specmap_cli.maps.text_files import read_tum

    _need(
        (truth.relations is None) == (len(truth.references) == 1),
        "--trajectory needs one of --relations FILE and --reference FILE.tum",
    )
    poses = read_tum(trajectory)
    if truth.relations is not None:
        errors = relation_errors(poses, read_relations(truth.relations))
        return Found(asdict(errors), relation_lines(errors))
    found = reference_errors(poses, read_tum(truth.references[0]))
    return Found(found.as_dict(), reference_lines(found))


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
