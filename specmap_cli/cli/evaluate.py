"""`specmap evaluate`: scores of maps, labels and trajectories against truth."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files

if TYPE_CHECKING:
    from specmap_cli.core.config import Config
    from specmap_cli.evaluation.classification import ClassificationScores
    from specmap_cli.evaluation.protocols import HoldOut


class Protocol(StrEnum):
    """What is held against the truth."""

    HOLDOUT = "holdout"
    REVISIT = "revisit"


class Baseline(StrEnum):
    """What the method is compared with."""

    ROOM_HALLWAY = "room-hallway"


class Split(StrEnum):
    """How scans are held out."""

    RANDOM = "random"
    BLOCKS = "blocks"


_Logs = Annotated[
    list[Path] | None,
    typer.Argument(
        metavar="[LOG] [LOG2]",
        help="holdout: a log. revisit: a log or its map directory, and the other log. "
        "room-hallway: the log to learn from, and the log to name.",
        show_default=False,
    ),
]
_Protocol = Annotated[
    Protocol | None,
    typer.Option(
        help="holdout: label scans held out of the map (Table II of the paper); "
        "revisit: label another log (Figure 6)."
    ),
]
_Baseline = Annotated[
    Baseline | None,
    typer.Option(help="room-hallway: kinds of places instead of places (Figure 5c)."),
]
_Trajectory = Annotated[
    Path | None, typer.Option(help="Trajectory to score, such as out/trajectory.tum.")
]
_Relations = Annotated[
    Path | None, typer.Option(help="True relative poses: t1 t2 x y z roll pitch yaw.")
]
_Reference = Annotated[
    list[Path] | None,
    typer.Option(help="True poses, TUM. With two logs: of the first, then of the second."),
]
_Rooms = Annotated[
    list[Path] | None,
    typer.Option(
        help="room-hallway: picture of the rooms, white, its lower left corner the origin of the "
        "true poses; a second one when LOG2 is of another building."
    ),
]
_Resolution = Annotated[float, typer.Option(min=0.001, help="Metres a pixel of --rooms.")]
_Split = Annotated[Split, typer.Option(help="How scans are held out.")]
_Share = Annotated[float, typer.Option(min=0.01, max=0.9, help="Share held out.")]
_Block = Annotated[int, typer.Option(min=1, help="Scans of a block.")]
_Seed = Annotated[int, typer.Option(min=0, help="Seed of the split.")]
_Confusion = Annotated[Path | None, typer.Option(help="PNG of the confusion matrix to write.")]


@dataclass(frozen=True, slots=True)
class _Printing:
    """How a result is shown."""

    confusion: Path | None
    quiet: bool
    as_json: bool

    def result(
        self, found: dict[str, Any], lines: list[str], scores: ClassificationScores | None = None
    ) -> None:
        """Write the confusion matrix where it was asked for, print the rest."""
        from specmap_cli.cli.console import print_result
        from specmap_cli.drawing.confusion import render_confusion
        from specmap_cli.grids.map_server import write_png

        if self.confusion is not None and scores is not None:
            names = [str(id_) for id_ in scores.ids]
            picture = render_confusion(scores.confusion, names, [*names, "unknown"])
            write_png(self.confusion, picture)
        print_result(found, lines, self.as_json)


def evaluate(
    logs: _Logs = None,
    protocol: _Protocol = None,
    baseline: _Baseline = None,
    trajectory: _Trajectory = None,
    relations: _Relations = None,
    reference: _Reference = None,
    rooms: _Rooms = None,
    resolution: _Resolution = 0.05,
    split: _Split = Split.RANDOM,
    share: _Share = 0.2,
    block: _Block = 100,
    seed: _Seed = 0,
    confusion: _Confusion = None,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Score localisation or a trajectory against truth.

    --json gives the same figures as one object: of holdout {"train": {"recall", "precision",
    "scans", ...}, "test": {...}, "filtered": {...}, "submaps": [...]}.

    \b
    specmap evaluate log.mcap --protocol holdout
    specmap evaluate map log2.mcap --protocol revisit --reference log.tum --reference log2.tum
    specmap evaluate --trajectory map/trajectory.tum --reference log.tum
    """
    from specmap_cli.core.config import load_config
    from specmap_cli.evaluation.protocols import HoldOut

    paths, truths = logs or [], reference or []
    tasks = {"protocol": protocol, "baseline": baseline, "trajectory": trajectory}
    task = _only_one([name for name, value in tasks.items() if value is not None])
    _need(
        confusion is None or protocol is not None, "--confusion is of --protocol: leave it out here"
    )
    check_files([confusion], [*paths, *truths, *(rooms or [])], overwrite=overwrite)
    printing = _Printing(confusion, quiet, as_json)
    effective = load_config(config, preset, options.overrides(settings))
    if trajectory is not None:
        _score_trajectory(trajectory, relations, truths, printing)
    elif task == "baseline":
        _name_places(paths, truths, rooms or [], resolution, effective, printing)
    elif protocol is Protocol.HOLDOUT:
        _hold_out(paths, HoldOut(split.value, share, block, seed), effective, printing)
    else:
        _revisit(paths, truths, effective, printing)


def _only_one(asked: list[str]) -> str:
    from specmap_cli.core.errors import UsageError

    if len(asked) == 1:
        return asked[0]
    raise UsageError(
        "say what to evaluate, and one thing only: LOG --protocol holdout, or LOG LOG2 --protocol "
        "revisit, or LOG LOG2 --baseline room-hallway, or --trajectory FILE.tum"
    )


def _need(condition: bool, usage: str) -> None:
    from specmap_cli.core.errors import UsageError

    if not condition:
        raise UsageError(usage)


def _score_trajectory(
    trajectory: Path, relations: Path | None, references: list[Path], printing: _Printing
) -> None:
    from specmap_cli.evaluation import trajectories
    from specmap_cli.evaluation.reports import reference_lines, relation_lines

    _need(
        (relations is None) == (len(references) == 1),
        "--trajectory needs one of --relations FILE and --reference FILE.tum",
    )
    poses = trajectories.read_tum(trajectory)
    if relations is not None:
        errors = trajectories.relation_errors(poses, trajectories.read_relations(relations))
        printing.result(asdict(errors), relation_lines(errors))
    else:
        found = trajectories.reference_errors(poses, trajectories.read_tum(references[0]))
        printing.result(found.as_dict(), reference_lines(found))


def _hold_out(logs: list[Path], choice: HoldOut, config: Config, printing: _Printing) -> None:
    from specmap_cli.cli.console import ConsoleProgress
    from specmap_cli.evaluation.protocols import hold_out
    from specmap_cli.evaluation.reports import hold_out_lines

    _need(len(logs) == 1, "--protocol holdout needs one log: specmap evaluate LOG --protocol ...")
    with ConsoleProgress(printing.quiet) as progress:
        result = hold_out(logs, config, choice, progress)
    printing.result(result.as_dict(), hold_out_lines(result), result.test)


def _revisit(logs: list[Path], references: list[Path], config: Config, printing: _Printing) -> None:
    from specmap_cli.cli.console import ConsoleProgress
    from specmap_cli.evaluation.reports import revisit_lines, revisit_logs

    _need(
        len(logs) == len(references) == 2,
        "--protocol revisit needs LOG LOG2 and --reference twice: the true poses of each",
    )
    with ConsoleProgress(printing.quiet) as progress:
        result = revisit_logs(logs[0], logs[1], (references[0], references[1]), config, progress)
    printing.result(result.as_dict(), revisit_lines(result), result.filtered)


def _name_places(
    logs: list[Path],
    references: list[Path],
    pictures: list[Path],
    resolution: float,
    config: Config,
    printing: _Printing,
) -> None:
    from specmap_cli.cli.console import ConsoleProgress
    from specmap_cli.evaluation.reports import semantic_lines
    from specmap_cli.evaluation.semantic import Labelled, room_hallway
    from specmap_cli.simulation.worlds import read_rooms

    _need(
        len(logs) == len(references) == 2 and len(pictures) in (1, 2),
        "--baseline room-hallway needs LOG LOG2, --reference twice (the true poses of each) and "
        "--rooms once, or twice for two buildings",
    )
    plans = [read_rooms(picture, resolution) for picture in pictures]
    learned = Labelled(logs[0], references[0], plans[0])
    asked = Labelled(logs[1], references[1], plans[-1])
    with ConsoleProgress(printing.quiet) as progress:
        result = room_hallway(learned, asked, config, progress)
    printing.result(result.as_dict(), semantic_lines(result))
