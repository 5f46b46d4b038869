"""The commands about a finished map: localize, compare, check, history, report, export; and edit,
which is what a person decides about it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from specmap_cli.cli.options import (
    WRITTEN,
    Bounds,
    Common,
    Logs,
    LogSettings,
    MapDirectory,
    Overwrite,
    Settings,
    argument,
    check_files,
    keep_inputs,
    option,
    output,
    uses_of,
)
from specmap_cli.core.errors import BROKEN_RULE, MapError, UsageError

if TYPE_CHECKING:
    from specmap_cli.pipelines.edits import RequestedEdits

_MOST_SCANS = 0.5  # share of the scans that makes most of them


def localize(
    logs: Logs,
    map_directory: Annotated[
        Path, option("Map directory written by `specmap build`.", "--map", "-m")
    ],
    out: Annotated[Path | None, output("CSV to write, a line a scan.", "--output")] = None,
    plot: Annotated[
        Path | None, option("PNG to write: the predicted submap along the trajectory."), WRITTEN
    ] = None,
    offline: Annotated[
        bool, option("Smooth over the whole log instead of filtering.", "--offline")
    ] = False,
    metric: Annotated[
        bool, option("A pose, too, where one place of the map leads clearly.", "--metric")
    ] = False,
    overwrite: Overwrite = False,
    fail_on: Annotated[
        Literal["unknown"] | None,
        option("Exit with code 5 when most scans are unknown. All is written anyway."),
    ] = None,
    *,
    settings: LogSettings,
    common: Common,
) -> None:
    """Tell, scan by scan, in which submap a log was recorded.

    Gives the raw vote of single scans and the label of a hidden Markov filter over the topology.

    The settings are those the map was built with, but for topics and frames. --config and --set
    change some of them. --preset, and a file that names a preset, take the place of all of them.

    \b
    specmap localize other.mcap --map map -o labels.csv --plot labels.png
    specmap localize other.mcap --map map --offline --metric --json
    """
    from specmap_cli.pipelines.localize import localize_log, write_report

    stored = settings.read(map_directory)
    check_files([out, plot], [*logs, map_directory], common, overwrite=overwrite)
    if plot is not None and plot.suffix.lower() not in ("", ".png"):
        raise UsageError("what is drawn is a PNG", "name it so: PLOT.png", where=plot)
    effective = settings.of_map(stored)
    with common.progress() as progress:
        report = localize_log(
            logs, stored, effective, offline=offline, metric=metric, progress=progress
        )
    write_report(report, stored, metric=metric, csv=out, plot=plot)
    common.show(report.as_dict(), report.lines())
    if fail_on is not None and report.known < _MOST_SCANS:
        raise typer.Exit(BROKEN_RULE)


def compare(
    old: Annotated[Path, argument("OLD", "Map directory written by `specmap build`.")],
    new: Annotated[Path, argument("NEW", "A later map of the same building.")],
    out: Annotated[
        Path | None, output("Directory to write: summary.txt, compare.json, compare.png.")
    ] = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
    common: Common,
) -> None:
    """Tell what differs between two maps of one building.

    The maps find each other by what they show; they need no common frame. Then: submaps that are
    the same, new, gone, split or merged; ways that were closed or opened; walls and furniture that
    appeared or vanished, judged where both maps saw. Maps that do not fit in one way only are
    refused with the reason, exit code 4. Of the settings only the section `limits` counts.

    \b
    specmap compare monday friday
    specmap compare monday friday -o changes --json
    """
    from specmap_cli.maps.directory import result_directory
    from specmap_cli.pipelines import compare as comparing
    from specmap_cli.pipelines.history import span_ns

    if out is not None:
        keep_inputs([out], [old, new])
    one, other = settings.read(old), settings.read(new)
    effective = settings.of_map(one)
    with common.progress() as progress, ExitStack() as outputs:
        partial = out and outputs.enter_context(
            result_directory(out, comparing.FILES, overwrite, progress)
        )
        found = comparing.compare_maps(one, other, effective, progress)
        if partial is not None:
            comparing.write_comparison(found, partial)
        if span_ns(one)[1] > span_ns(other)[1]:
            progress.note(f"{new}: its last scan is older than that of {old}: are they swapped?")
    record, look = found.record, [f"look at {out / comparing.PICTURE}"] if out else []
    common.show(record.model_dump(), [*comparing.lines_of(record), *look])


def check(
    map_: MapDirectory,
    rules: Annotated[Path | None, option("TOML file of rules; they go over the defaults.")] = None,
    against: Annotated[
        Path | None, option("A map of the same building that is right.", metavar="GOLDEN")
    ] = None,
    junit: Annotated[Path | None, option("JUnit XML to write, a test a rule."), WRITTEN] = None,
    markdown: Annotated[
        Path | None, option("Markdown to write: a table for the summary page of a CI."), WRITTEN
    ] = None,
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Check a map by rules; exit code 5 when it breaks one.

    Rules bound figures of the map: scans lost, findings of its verdict, parts, submaps, seconds,
    memory. With --against they also bound what differs from a golden map of the building: submaps
    that are gone, ways that are closed, how far walls lie off. What a map does not say breaks a
    rule, too. Of the settings only the section `limits` counts.

    \b
    specmap check map
    specmap check map --rules rules.toml --junit check.xml
    specmap check tonight --against golden --markdown summary.md
    """
    from specmap_cli.checking import rules as checking
    from specmap_cli.core.files import write_together
    from specmap_cli.pipelines.check import check_map

    in_force = checking.read_rules(rules, against=against is not None)
    stored = settings.read(map_)
    golden = None if against is None else settings.read(against)
    check_files([junit, markdown], [map_, against, rules], common, overwrite=overwrite)
    with common.progress() as progress:
        record = check_map(stored, in_force, golden, progress)
    written = ((junit, checking.junit), (markdown, checking.markdown))
    write_together({path: made(record) for path, made in written if path is not None})
    common.show(record.model_dump(), checking.lines_of(record))
    if not record.passed:
        raise typer.Exit(BROKEN_RULE)


def history(
    maps: Annotated[list[Path], argument("MAP...", "Map directories, or directories of them.")],
    out: Annotated[
        Path | None,
        output(
            "Directory to write: history.html, history.json, visits.csv, days.csv, changes.csv."
        ),
    ] = None,
    timezone: Annotated[
        str, option("Where days begin and end, such as Europe/Berlin.", metavar="NAME")
    ] = "UTC",
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Tell which rooms were visited how often, and what changed when.

    Maps of many days are put in the order of their recordings. Those that fit to one another are
    one building; each is compared with the one before. A recording that several maps were made of
    counts once. A map that cannot be read is left out and told, and the exit code is 3 at the end.
    Of the settings only the section `limits` counts.

    \b
    specmap history monday tuesday wednesday
    specmap history maps/ -o week --timezone Europe/Berlin
    """
    from specmap_cli.maps.directory import result_directory
    from specmap_cli.pipelines.history import FILES, PAGE, history_of, write_history

    if out is not None:
        keep_inputs([out], maps)
    limits = settings.load().limits
    with common.progress() as progress, ExitStack() as outputs:
        partial = out and outputs.enter_context(result_directory(out, FILES, overwrite, progress))
        report = history_of(maps, timezone, limits, progress)
        if out is not None and partial is not None:
            write_history(report, partial, out, limits)
    record, look = report.record, [f"look at {out / PAGE}"] if out else []
    common.show(record.model_dump(), [*report.lines(), *look])
    if record.left_out:
        raise typer.Exit(MapError.exit_code)


def report(
    map_: MapDirectory,
    out: Annotated[Path, output("HTML file to write.")] = Path("report.html"),
    compare: Annotated[
        Path | None,
        option(
            "An older map of the same building: what differs is drawn and listed.", metavar="OLD"
        ),
    ] = None,
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Write a page about a map, for any browser.

    One file that loads nothing: the map in layers, its submaps with all that is known of them, the
    way of the robot over time, findings, split tests, loop closures, and how the map was made. Of
    the settings only the section `limits` counts: how large a file of the map may be.

    \b
    specmap report map -o map.html
    specmap report friday --compare monday -o friday.html
    """
    from specmap_cli.core.files import write_text
    from specmap_cli.pipelines.report import report_map

    stored = settings.read(map_)
    older = None if compare is None else settings.read(compare)
    check_files([out], [map_, compare], common, overwrite=overwrite)
    with common.progress() as progress:
        page = report_map(stored, older, settings.load(), progress)
    write_text(out, page)
    size = len(page.encode("utf-8"))
    result = {
        "map": str(map_),
        "compare": None if compare is None else str(compare),
        "out": str(out),
        "submaps": len(stored.rooms),
        "bytes": size,
    }
    common.show(result, [f"{out}: {size / 1e6:.1f} MB: open it in a browser"])


def export(
    map_: MapDirectory,
    format_: Annotated[
        str, option("One of those above, or of an installed package.", "--format", "-f")
    ],
    out: Annotated[Path, output("File to write.")],
    overwrite: Overwrite = False,
    *,
    settings: Bounds,
    common: Common,
) -> None:
    """Write a map in the format of another tool.

    \b
    nav2        the ways as a graph for Nav2's route server
    nav2-masks  keepout and speed masks for Nav2's costmap filters, in a zip
    rmf         building map and nav graph for Open-RMF, in a zip
    lif         a layout (LIF) for VDA 5050 fleets
    tmap2       the ways as a topological map for LCAS topological_navigation
    geojson     outlines, doors and ways in metres of the map, for QGIS
    graphml     the graph alone, for yEd, Gephi and networkx
    csv         submaps, links and doors as tables, in a zip
    pose-graph  the layout's graph as g2o, for GTSAM and g2o
    foxglove    map, graph, trajectory and scans over time, as an MCAP
    rerun       the same as an .rrd; needs `pip install 'specmap-cli[rerun]'`

    Installed packages may add formats. Of the settings only the section `limits` counts: how large
    a file of the map may be. What would mislead is told as a warning. A map that the format cannot
    hold is refused with exit code 3, such as one without any way for nav2.

    \b
    specmap export map --format nav2 -o map.geojson
    """
    from specmap_cli.exports.table import export_map, exporters

    stored = settings.read(map_)
    check_files([out], [map_], common, overwrite=overwrite)
    with common.progress() as progress:
        if stored.note:
            progress.note(stored.note)
        warnings = export_map(stored, format_, out, overwrite=overwrite, progress=progress)
    result = {
        "map": str(map_),
        "out": str(out),
        "format": format_,
        "submaps": len(stored.rooms),
        "edges": len(stored.record.edges),
        "warnings": warnings,
    }
    common.show(result, [f"{out}: {exporters()[format_].description}"])


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """What is said of submaps, and what is changed of borders and ways."""

    rename: Annotated[
        list[str] | None, option('Name a submap; "" takes the name back.', metavar="ID NAME")
    ] = None
    kind: Annotated[
        list[str] | None, option("Say what it is: room, corridor or hall.", metavar="ID KIND")
    ] = None
    set_property: Annotated[
        list[str] | None,
        option(
            "Note something: text, a number, true or false; KEY= takes it back.",
            metavar="ID KEY=VALUE",
        ),
    ] = None
    forget: Annotated[
        list[int] | None, option("Take back name, kind and properties of a submap.", metavar="ID")
    ] = None
    merge: Annotated[
        list[str] | None, option("Make the second submap a part of the first.", metavar="ID ID")
    ] = None
    split: Annotated[
        list[str] | None,
        option(
            "Cut a submap along a line; what is right of it, seen from the first point, gets "
            "a new id.",
            metavar="ID X1,Y1,X2,Y2",
        ),
    ] = None
    forbid_door: Annotated[
        list[str] | None, option("Robots must not go from one to the other.", metavar="ID ID")
    ] = None
    at: Annotated[
        list[str] | None,
        option("Place of the forbidden door, once for each --forbid-door.", metavar="X,Y"),
    ] = None
    undo: Annotated[
        list[int] | None,
        option("Take back a change by its number in edits.toml.", metavar="NUMBER"),
    ] = None


def edit(
    map_: MapDirectory,
    out: Annotated[
        Path | None, output("Map directory to write; without it MAP itself is changed.")
    ] = None,
    overwrite: Overwrite = False,
    *,
    said: Said,
    settings: Bounds,
    common: Common,
) -> None:
    """Name submaps, move borders, forbid doors.

    What is decided is kept in MAP/edits.toml, which may be edited by hand, too: without options the
    file is made to hold. Updates and rebuilds with --like do so, too. MAP is replaced, complete or
    not at all; with -o it stays as it is. A map whose borders change is made anew with the settings
    that it was built with; of those given here only the section `limits` counts.

    \b
    specmap edit map --rename 3 Kitchen --kind 3 room --set-property 3 floor=2
    specmap edit map --merge 3 4 --split 5 1.5,2,1.5,6 -o map2
    specmap edit map --forbid-door 3 5 --at 1.5,2.0
    """
    from specmap_cli.exports.routes import misnoted
    from specmap_cli.pipelines.edit import edit_map

    requested = _requested(said)
    if out is not None and out.resolve() != map_.resolve():
        keep_inputs([out], [map_])
        if map_.resolve() in out.resolve().parents:
            raise UsageError(f"is inside the map {map_}", "choose another place", where=out)
    stored = settings.read(map_)
    with common.progress() as progress:
        report = edit_map(stored, requested, out, overwrite=overwrite, progress=progress)
        if requested.properties:
            for line in misnoted(settings.read(report.out).record):
                progress.warn(line)
    common.show(report.as_dict(), report.lines())


def _requested(said: Said) -> RequestedEdits:
    """What the options ask for. Raises UsageError for one that cannot be read."""
    from specmap_cli.core.toml import value_of
    from specmap_cli.pipelines.edits import RequestedEdits

    properties: dict[int, dict[str, Any]] = {}
    for id_, assignment in uses_of("--set-property", said.set_property, "ID KEY=VALUE"):
        key, separator, text = (part.strip() for part in assignment.partition("="))
        if not separator or not key:
            raise UsageError(
                hint="expected KEY=VALUE, such as floor=2", where=f"--set-property {assignment}"
            )
        # a value that is no TOML is text, an empty one takes the property back
        value = value_of(text) if text else None
        properties.setdefault(_id("--set-property", id_), {})[key] = value
    return RequestedEdits(
        names={_id("--rename", i): name for i, name in uses_of("--rename", said.rename, "ID NAME")},
        kinds={_id("--kind", i): kind for i, kind in uses_of("--kind", said.kind, "ID KIND")},
        properties=properties,
        forget=tuple(said.forget or ()),
        changes=tuple(_changes(said)),
        undo=tuple(said.undo or ()),
    )


def _changes(said: Said) -> Iterator[dict[str, Any]]:
    """The changes, as in edits.toml: merges, then splits, then forbidden doors."""
    for ids in uses_of("--merge", said.merge, "ID ID"):
        yield {"merge": [_id("--merge", id_) for id_ in ids]}
    for id_, line in uses_of("--split", said.split, "ID X1,Y1,X2,Y2"):
        x1, y1, x2, y2 = _numbers("--split", line, "X1,Y1,X2,Y2")
        yield {"split": _id("--split", id_), "line": [[x1, y1], [x2, y2]]}
    doors, places = said.forbid_door or [], said.at or []
    if places and len(places) != len(doors):
        raise UsageError(hint="give it once for each --forbid-door, or not at all", where="--at")
    for number, ids in enumerate(uses_of("--forbid-door", doors, "ID ID")):
        at = {"at": _numbers("--at", places[number], "X,Y")} if places else {}
        yield {"forbid": [_id("--forbid-door", id_) for id_ in ids], **at}


def _id(option: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise UsageError(hint="expected the id of a submap, such as 3", where=f"{option} {text}")
    return int(text)


def _numbers(option: str, text: str, names: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != len(names.split(",")):
        hint = f"expected {names} in metres, separated by commas"
        raise UsageError(hint=hint, where=f"{option} {text}")
    return numbers
