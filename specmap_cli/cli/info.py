"""`specmap info`: what a recording holds and which command to run next."""

from __future__ import annotations

from specmap_cli.cli import options


def info(logs: options.Logs, as_json: options.Json = False) -> None:
    """Show what a recording holds, and what to run next.

    Topics with their types, counts and rates, the duration, the frames, the scans, and what
    `specmap build` would read.

    \b
    specmap info log.mcap
    specmap info recording_directory --json
    """
    from specmap_cli.cli.console import print_result
    from specmap_cli.logs import open_log
    from specmap_cli.logs.summary import summarize

    with open_log(logs) as log:
        summary = summarize(log)
    print_result(summary.to_dict(), summary.lines(), as_json)
