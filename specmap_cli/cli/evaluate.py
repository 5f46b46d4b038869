"""`specmap evaluate`: scores of maps, labels and trajectories against truth."""

from __future__ import annotations

from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from specmap_cli.cli import options
from specmap_cli.cli.targets import check_files

if TYPE_CHECKING:
    from specmap_cli.config import Config
    from specmap_cli.evaluation.classification import ClassificationScores


class Protocol(StrEnum):
    """What is held against the truth."""

    HOLDOUT = "holdout"
    REVISIT = "revisit"


class Split(StrEnum):
    """How scans are held out."""

    RANDOM = "random"
    BLOCKS = "blocks"


def evaluate(
    logs: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[LOG] [LOG2]",
            help="holdout: a log. revisit: a log or its map directory, and the other log.",
            show_default=False,
        ),
    ] = None,
    protocol: Annotated[
        Protocol | None,
        typer.Option(
            help="holdout: label scans held out of the map (Table II of the paper); "
            "revisit: label another log (Figure 6)."
        ),
    ] = None,
    trajectory: Annotated[
        Path | None, typer.Option(help="Trajectory to score, such as out/trajectory.tum.")
    ] = None,
    relations: Annotated[
        Path | None, typer.Option(help="True relative poses: t1 t2 x y z roll pitch yaw.")
    ] = None,
    reference: Annotated[
        list[Path] | None,
        typer.Option(help="True poses, TUM. revisit: of the first log, then of the second."),
    ] = None,
    split: Annotated[Split, typer.Option(help="How scans are held out.")] = Split.RANDOM,
    share: Annotated[float, typer.Option(min=0.01, max=0.9, help="Share held out.")] = 0.2,
    block: Annotated[int, typer.Option(min=1, help="Scans of a block.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the split.")] = 0,
    confusion: Annotated[
        Path | None, typer.Option(help="PNG of the confusion matrix to write.")
    ] = None,
    preset: options.Preset = None,
    config: options.ConfigFile = None,
    settings: options.Settings = None,
    overwrite: options.Overwrite = False,
    quiet: options.Quiet = False,
    as_json: options.Json = False,
) -> None:
    """Score localisation or a trajectory against truth.

    \b
    specmap evaluate log.mcap --protocol holdout
    specmap evaluate map log2.mcap --protocol revisit --reference log.tum --reference log2.tum
    specmap evaluate --trajectory map/trajectory.tum --reference log.tum
    """
    from specmap_cli.config import load_config
    from specmap_cli.errors import UsageError

    paths, truths = logs or [], reference or []
    check_files([confusion], [*paths, *truths], overwrite=overwrite)
    if trajectory is not None:
        _score_trajectory(trajectory, relations, truths, as_json)
        return
    effective = load_config(config, preset, options.overrides(settings))
    if protocol is Protocol.HOLDOUT and len(paths) == 1:
        _hold_out(paths[0], split, share, block, seed, effective, confusion, quiet, as_json)
    elif protocol is Protocol.REVISIT and len(paths) == 2 and len(truths) == 2:
        _revisit(paths, truths, effective, confusion, quiet, as_json)
    else:
        raise UsageError(
            "say what to evaluate: LOG --protocol holdout, or LOG --protocol revisit LOG2 with "
            "--reference twice, or --trajectory with --relations or --reference"
        )


def _score_trajectory(
    trajectory: Path, relations: Path | None, references: list[Path], as_json: bool
) -> None:
    from specmap_cli.cli.console import print_result
    from specmap_cli.errors import UsageError
    from specmap_cli.evaluation import trajectories
    from specmap_cli.evaluation.reports import reference_lines, relation_lines

    if (relations is None) == (len(references) != 1):
        raise UsageError("--trajectory needs one of --relations FILE and --reference FILE.tum")
    poses = trajectories.read_tum(trajectory)
    if relations is not None:
        errors = trajectories.relation_errors(poses, trajectories.read_relations(relations))
        print_result(asdict(errors), relation_lines(errors), as_json)
    else:
        found = trajectories.reference_errors(poses, trajectories.read_tum(references[0]))
        print_result(found.as_dict(), reference_lines(found), as_json)


def _hold_out(
    log: Path,
    split: Split,
    share: float,
    block: int,
    seed: int,
    config: Config,
    confusion: Path | None,
    quiet: bool,
    as_json: bool,
) -> None:
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.evaluation.protocols import HoldOut, hold_out
    from specmap_cli.evaluation.reports import hold_out_lines

    with ConsoleProgress(quiet) as progress:
        result = hold_out([log], config, HoldOut(split.value, share, block, seed), progress)
    _write_confusion(confusion, result.test)
    print_result(result.as_dict(), hold_out_lines(result), as_json)


def _revisit(
    logs: list[Path],
    references: list[Path],
    config: Config,
    confusion: Path | None,
    quiet: bool,
    as_json: bool,
) -> None:
    from specmap_cli.cli.console import ConsoleProgress, print_result
    from specmap_cli.evaluation.reports import revisit_lines, revisit_logs

    with ConsoleProgress(quiet) as progress:
        result = revisit_logs(logs[0], logs[1], (references[0], references[1]), config, progress)
    _write_confusion(confusion, result.filtered)
    print_result(result.as_dict(), revisit_lines(result), as_json)


def _write_confusion(path: Path | None, scores: ClassificationScores) -> None:
    from specmap_cli.outputs.confusion import render_confusion
    from specmap_cli.outputs.grids import write_png

    if path is not None:
        names = [str(id_) for id_ in scores.ids]
        write_png(path, render_confusion(scores.confusion, names, [*names, "unknown"]))
