"""The application and its commands; those that tell of the program itself are here."""

from __future__ import annotations

import copy
import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any

import typer

from specmap_cli.cli import making, maps, recordings
from specmap_cli.cli.entry import print_text
from specmap_cli.cli.options import Common, JoinedCommand, Settings, argument, option, unfolded
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
        from specmap_cli.core.process import versions

        print_text("".join(f"{name} {version}\n" for name, version in versions().items()))
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    _version: Annotated[
        bool,
        option(
            "Show the versions of specmap and of what it stands on.",
            "--version",
            callback=_show_version,
            is_eager=True,
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


def config(settings: Settings, common: Common) -> None:
    """Print the configuration in force as TOML.

    Every key with its value and what it is for, ready to edit and give back with --config.

    \b
    specmap config > specmap.toml
    specmap config --preset paper --set seed=3
    """
    from specmap_cli.core.toml import to_toml

    effective = settings.load()
    as_json = common.as_json
    print_text(effective.model_dump_json(indent=2) + "\n" if as_json else to_toml(effective))


def schema(
    name: Annotated[str | None, argument("NAME", "One of those listed without a name.")] = None,
    *,
    common: Common,
) -> None:
    """Print a JSON Schema, or list those that there are.

    There is one of what each command prints with --json, by the name of the command; one of an
    error; and one of each JSON file in a map. The last number of its $id is the schema_version of
    what it describes: it changes when a program that reads it would have to.

    \b
    specmap schema
    specmap schema build > build.schema.json
    """
    import json

    from specmap_cli.core.schemas import read_schema, schema_names

    if name is not None:
        print_text(json.dumps(read_schema(name), indent=2, sort_keys=True) + "\n")
        return
    entries = []
    for each in schema_names():
        found = read_schema(each)
        entries.append({"name": each, "id": found["$id"], "title": found["title"]})
    lines = [f"{entry['name']:<12} {entry['title']}" for entry in entries]
    common.show({"schemas": entries}, lines)


_COMMANDS: tuple[Callable[..., None], ...] = (  # in the order of the help
    recordings.info,
    making.build,
    maps.localize,
    making.update,
    making.merge,
    maps.compare,
    maps.check,
    maps.history,
    making.batch,
    maps.edit,
    maps.report,
    making.segment,
    recordings.evaluate,
    recordings.simulate,
    recordings.convert,
    maps.export,
    config,
    schema,
)
for _command in _COMMANDS:
    app.command(_command.__name__, epilog=EXIT_CODES, cls=JoinedCommand)(unfolded(_command))


def _advice(error: Any, context: Any) -> str:
    """What to do about a wrong line: how a setting or a map is given, where one was meant."""
    if context is None:
        return "see `specmap --help`"
    usual = f"see `{context.command_path} --help`"
    takes_settings = any("--preset" in each.opts for each in context.command.params)
    if takes_settings and hasattr(error, "possibilities"):  # there is no such option
        from specmap_cli.core.config import SETTINGS

        key = SETTINGS.meant(error.option_name.strip("-").replace("-", "_"))
        return f"a setting is given as --set {key}=VALUE; {usual}" if "." in key else usual
    if "--map" in getattr(getattr(error, "param", None), "opts", ()):
        from pathlib import Path

        from specmap_cli.maps.filenames import TOPOLOGY

        for path in context.params.get("logs") or ():
            if (Path(path) / TOPOLOGY).is_file():
                return f"a map is given as --map {path}; {usual}"
    return usual


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit code; UsageError for arguments that make no command."""
    given = sys.argv[1:] if arguments is None else arguments
    # Typer makes all commands that it is told of, which takes a while: it is told of the one named
    named = [command for command in app.registered_commands if command.name in given[:1]]
    own = copy.copy(app)
    own.registered_commands = named or app.registered_commands
    try:
        code = own(args=arguments, prog_name="specmap", standalone_mode=False)
    except _WRONG_LINE as error:
        context = getattr(error, "ctx", None)
        message = error.format_message().rstrip(".")  # type: ignore[attr-defined]
        findings = getattr(error.__cause__, "errors", None)  # Typer holds bounds by pydantic
        if findings is not None:
            from specmap_cli.core.text import said

            theirs = error.message  # type: ignore[attr-defined]
            message = message.replace(theirs, said(findings()[0]), 1)
        message = message.replace(": Value error, ", ": ", 1)  # pydantic's word, not ours
        told = UsageError(message, _advice(error, context), mark=";")
        # the option or the argument that it complains of, which stands within the message
        parameter = getattr(error, "param", None)
        if parameter is None:
            told.where = getattr(error, "option_name", None)
        elif parameter.param_type_name == "option":
            told.where = str(parameter.opts[0])
        else:
            told.where = str(parameter.metavar or parameter.name)
        raise told from None
    except SystemExit as leaving:
        if isinstance(leaving.__context__, BrokenPipeError):  # `specmap --help | head`
            return 0
        raise
    return code if isinstance(code, int) else 0
