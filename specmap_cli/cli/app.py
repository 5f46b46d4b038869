"""The application and its commands."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from specmap_cli import __version__
from specmap_cli.cli import (
    build,
    configuration,
    convert,
    evaluate,
    info,
    localize,
    segment,
    simulate,
)
from specmap_cli.core.errors import UsageError

EXIT_CODES = (
    "Exit codes: 0 done; 1 a bug, with its traceback; 2 wrong usage or an output in the way; "
    "3 an input that cannot be used; 4 no result; 130 and 143 interrupted by Ctrl-C and SIGTERM."
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
        typer.echo(f"specmap {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Topological maps from robot laser logs, without ROS.

    \b
    specmap info log.mcap                        what a recording holds
    specmap build log.mcap -o map                its topological map
    specmap localize other.mcap --map map        where another log was recorded
    specmap COMMAND --help                       all about a command
    """
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(UsageError.exit_code)


_COMMANDS: dict[str, Callable[..., Any]] = {
    "info": info.info,
    "build": build.build,
    "localize": localize.localize,
    "segment": segment.segment,
    "evaluate": evaluate.evaluate,
    "simulate": simulate.simulate,
    "convert": convert.convert,
    "config": configuration.show_config,
}
for _name, _command in _COMMANDS.items():
    app.command(_name, epilog=EXIT_CODES)(_command)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; UsageError for arguments that make no command."""
    try:
        code = app(args=arguments, prog_name="specmap", standalone_mode=False)
    except typer.TyperException as error:
        context = getattr(error, "ctx", None)
        command = context.command_path if context is not None else "specmap"
        message = error.format_message().rstrip(".")
        raise UsageError(f"{message}; see `{command} --help`") from None
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # `specmap --help | head`
            return 0
        raise
    return code if isinstance(code, int) else 0
