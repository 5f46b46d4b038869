"""The application, its commands, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import signal
import sys
from collections.abc import Sequence
from types import FrameType
from typing import Annotated

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
from specmap_cli.errors import SpecmapError

app = typer.Typer(
    name="specmap",
    help="Topological maps from robot laser logs, without ROS.",
    epilog="Start with: specmap info LOG, then specmap build LOG. "
    "Exit codes: 0 done, 1 a bug, 2 usage, 3 unusable input, 4 no result.",
    no_args_is_help=True,
    add_completion=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"specmap {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Topological maps from robot laser logs, without ROS."""


app.command("info")(info.info)
app.command("build")(build.build)
app.command("localize")(localize.localize)
app.command("segment")(segment.segment)
app.command("evaluate")(evaluate.evaluate)
app.command("simulate")(simulate.simulate)
app.command("convert")(convert.convert)
app.command("config")(configuration.show_config)


class _InterruptedError(BaseException):
    """A signal asked the run to end; not an Exception, so that nothing swallows it."""

    def __init__(self, number: int) -> None:
        self.number = number


def _interrupt(number: int, _frame: FrameType | None) -> None:
    """Unwind once: a second signal must not stop the cleaning up."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, signal.SIG_IGN)
    raise _InterruptedError(number)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the process's exit code."""
    for each in (signal.SIGINT, signal.SIGTERM):
        signal.signal(each, _interrupt)
    try:
        code = app(args=arguments, prog_name="specmap", standalone_mode=False)
        return code if isinstance(code, int) else 0
    except SpecmapError as error:
        return _fail(str(error), error.exit_code)
    except typer.TyperException as error:
        message = error.format_message()
        if not message:  # no arguments: the help was shown
            return 2
        return _fail(f"{message} (see specmap --help)", 2)
    except _InterruptedError as interruption:
        name = signal.Signals(interruption.number).name
        return _fail(f"interrupted by {name}; nothing was written", 128 + interruption.number)
    except BrokenPipeError:
        sys.stderr.close()
        return 0


def _fail(message: str, code: int) -> int:
    line = " ".join(message.split())
    print(f"specmap: error: {line}", file=sys.stderr)
    return code
