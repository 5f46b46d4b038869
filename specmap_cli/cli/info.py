"""`specmap info`: what a recording holds and which command to run next."""

from __future__ import annotations

from specmap_cli.cli.options import Common, Logs, LogSettings


def info(logs: Logs, settings: LogSettings, common: Common) -> None:
    """Show what a recording holds, and what to run next.

    Topics with their types, counts and rates, the duration, the frames, the scans, and what
    `specmap build` would read with the same options.

    \b
    specmap info log.mcap
    specmap info recording_directory --json
    """
    from specmap_cli.logs import open_log
    from specmap_cli.logs.inspection import summarize

    effective = settings.load()
    with open_log(logs, effective.log) as log:
        summary = summarize(log, effective.log)
    common.show(summary.to_dict(), summary.lines())
