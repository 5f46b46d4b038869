"""The application and its commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from specmap_cli.cli import (
    batch,
    build,
    check,
    compare,
    config,
    convert,
    edit,
    evaluate,
    export,
    history,
    info,
    localize,
    merge,
    report,
    schema,
    segment,
    simulate,
    update,
)
from specmap_cli.cli.options import telling
from specmap_cli.cli.typer_extras import JoinedCommand, unfolded
from specmap_cli.core.errors import UsageError

EXIT_CODES = (
    "Exit codes: 0 done; 1 a bug, with its traceback; 2 wrong usage or an output in the way; "
    "3 an input that cannot be used; 4 no result; 5 done, but "
    "a rule such as --fail-on is broken; 130 and 143 interrupted by Ctrl-C and SIGTERM."
)

# What Typer raises for arguments that make no command: only since 0.29 its root has a public name.
_WRONG_LINE = next(
    kind
    for kind in typer.BadParameter.__mro__
    if issubclass(kind, Exception) and kind.__base__ is Exception
)

app = typer.Typer(
    name="specmap",
    epilog=EXIT_CODES,
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        from specmap_cli.cli.streams import print_text
        from specmap_cli.core.process import versions

        print_text("".join(f"{name} {version}\n" for name, version in versions().items()))
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    _version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_show_version,
            is_eager=True,
            help="Show the versions of specmap and of what it stands on.",
        ),
    ] = False,
) -> None:
    """Topological maps from robot laser logs, without ROS.

    \b
    specmap info log.mcap                        what a recording holds
    specmap build log.mcap -o map                its topological map
    specmap localize other.mcap --map map        where another log was recorded
    specmap report map -o map.html               a page about the map, for people
    specmap COMMAND --help                       all about a command
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(UsageError.exit_code)


_COMMANDS: dict[str, Callable[..., Any]] = {
    "info": info.info,
    "build": build.build,
    "localize": localize.localize,
    "update": update.update,
    "merge": merge.merge,
    "compare": compare.compare,
    "check": check.check,
    "history": history.history,
    "batch": batch.batch,
    "edit": edit.edit,
    "report": report.report,
    "segment": segment.segment,
    "evaluate": evaluate.evaluate,
    "simulate": simulate.simulate,
    "convert": convert.convert,
    "export": export.export,
    "config": config.config,
    "schema": schema.schema,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, epilog=EXIT_CODES, cls=JoinedCommand)(unfolded(telling(_command)))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; UsageError for arguments that make no command."""
    try:
        code = app(args=arguments, prog_name="specmap", standalone_mode=False)
    except _WRONG_LINE as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "specmap"
        message = error.format_message().rstrip(".")  # type: ignore[attr-defined]
        message = message.replace(": Value error, ", ": ", 1)  # pydantic's word, not ours
        raise UsageError(f"{message}; see `{command} --help`") from None
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # `specmap --help | head`
            return 0
        raise
    return code if isinstance(code, int) else 0
