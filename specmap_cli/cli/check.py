"""`specmap check`: does a map keep the rules?"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from specmap_cli.cli.options import WRITTEN, Common, Map, Overwrite, Settings
from specmap_cli.cli.targets import check_files, files_of_map
from specmap_cli.core.errors import BROKEN_RULE

RulesFile = Annotated[
    Path | None, typer.Option("--rules", help="TOML file of rules; they go over the defaults.")
]
Against = Annotated[
    Path | None, typer.Option(metavar="GOLDEN", help="A map of the same building that is right.")
]
JUnit = Annotated[
    Path | None, typer.Option("--junit", help="JUnit XML to write, a test a rule."), WRITTEN
]
Markdown = Annotated[
    Path | None,
    typer.Option(help="Markdown to write: a table for the summary page of a CI."),
    WRITTEN,
]


def check(
    map_: Map,
    rules: RulesFile = None,
    against: Against = None,
    junit: JUnit = None,
    markdown: Markdown = None,
    overwrite: Overwrite = False,
    *,
    settings: Settings,
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
    from specmap_cli.checking.record import FORMATS
    from specmap_cli.checking.rules import read_rules
    from specmap_cli.core.files import write_together
    from specmap_cli.maps.store import read_map
    from specmap_cli.pipelines.check import check_map

    needed = [*files_of_map(map_), *([] if against is None else files_of_map(against))]
    wanted = {"junit": junit, "markdown": markdown}
    inputs = [*needed, *([] if rules is None else [rules])]
    check_files(wanted.values(), inputs, common, overwrite=overwrite)
    in_force = read_rules(rules, against=against is not None)
    limits = settings.load().limits
    stored = read_map(map_, limits)
    golden = None if against is None else read_map(against, limits)
    with common.progress() as progress:
        report = check_map(stored, in_force, golden, progress)
    write_together(
        {path: FORMATS[name](report.record) for name, path in wanted.items() if path is not None}
    )
    common.show(report.as_dict(), report.lines())
    if not report.passed:
        raise typer.Exit(BROKEN_RULE)
