"""The parameters that several commands share, declared once, and the settings they stand for.

Every command takes `Common`. One that computes with settings takes `Settings`; if it reads a log,
`LogSettings`. One that writes takes `Overwrite`, and `-o/--out` (`output`) for its output; other
options whose value is a file to write are marked `WRITTEN`. Outputs that cannot or must not be
written are refused before the work, not after it.

What Typer lacks: a group of options is a dataclass whose fields are the options. A command takes it
as one parameter, and Typer, which reads the signature, finds its fields there instead (`unfolded`).
And an option whose metavar has two words, such as `--rename ID NAME`, takes as many values and may
be repeated: the command gets the values of each use joined.
"""

from __future__ import annotations

import functools
import inspect
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, is_dataclass
from inspect import Parameter
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from typer.core import TyperCommand

from specmap_cli.cli.entry import JSON_VARIABLE, ConsoleProgress, print_text
from specmap_cli.core.errors import OUTPUT, SETTING, UsageError
from specmap_cli.core.progress import Level

if TYPE_CHECKING:
    from specmap_cli.batch.workers import Cluster
    from specmap_cli.core.settings import Config
    from specmap_cli.maps.store import Map

RECORDING = (
    "Recording: .mcap, rosbag2 directory or .db3, ROS 1 .bag, CARMEN .log; "
    "several files of one split recording together."
)
WRITTEN = "written"  # beside the option in its annotation; another option of a path is an input


def argument(metavar: str, what: str) -> Any:
    """An argument: how it is called in the help, and what it is."""
    return typer.Argument(metavar=metavar, help=what, show_default=False)


def option(what: str, *names: str, **rest: Any) -> Any:
    """An option: what it is for, its names if not that of the parameter, the rest as for Typer."""
    return typer.Option(*names, help=what, **rest)


Logs = Annotated[list[Path], argument("LOG", RECORDING)]
MapDirectory = Annotated[Path, argument("MAP", "Map directory written by `specmap build`.")]
Resolution = Annotated[float | None, option("Metres per pixel of a picture without a .yaml.")]
Overwrite = Annotated[bool, option("Replace an existing result.", "--overwrite")]


def output(what: str, *aliases: str, metavar: str | None = None) -> Any:
    """`-o/--out`: the output of a command, a directory or a file; `aliases` are other names."""
    return option(what, "--out", "-o", *aliases, metavar=metavar)


NewMap = Annotated[Path, output("Map directory to write.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Common:
    """How a command shows itself and its result: what every command has."""

    quiet: Annotated[
        bool,
        option(
            "Nothing on stderr but an error: as --log-level error.",
            "--quiet",
            "-q",
            envvar="SPECMAP_QUIET",
        ),
    ] = False
    log_level: Annotated[
        Level,
        option(
            "On stderr: errors alone; warnings, too; notes and progress; each stage and its time.",
            envvar="SPECMAP_LOG_LEVEL",
        ),
    ] = Level.INFO
    as_json: Annotated[
        bool,
        option(
            "Print one JSON object instead of text; an error is one, too.",
            "--json",
            envvar=JSON_VARIABLE,
        ),
    ] = False

    def progress(self) -> ConsoleProgress:
        """Progress, notes and warnings on stderr, as the level says."""
        return ConsoleProgress(Level.ERROR if self.quiet else self.log_level)

    def show(self, result: Mapping[str, Any], lines: Sequence[str]) -> None:
        """The result on stdout: one JSON object, or lines for a person.

        The object follows version 1 of the command's schema, unless it names another version.
        """
        from specmap_cli.core.text import to_json

        whole = {"schema_version": 1, **result}
        print_text(to_json(whole) if self.as_json else "\n".join(lines) + "\n")


@dataclass(frozen=True, slots=True, kw_only=True)
class Bounds:
    """The settings of a command for which only bounds of its inputs count, such as `limits`."""

    config: Annotated[
        Path | None,
        option("TOML file of settings (see `specmap config`).", envvar="SPECMAP_CONFIG"),
    ] = None
    assignments: Annotated[
        list[str] | None,
        option(
            "One setting, such as grid.resolution_m=0.1; repeatable.", "--set", metavar="KEY=VALUE"
        ),
    ] = None

    def load(self, flags: Mapping[str, Any] | None = None) -> Config:
        """The configuration in force; `flags` as for `overrides`. UsageError for a wrong one."""
        from specmap_cli.core.config import load_config

        preset = self.preset if isinstance(self, Settings) else None
        return load_config(self.config, preset, self.overrides(flags))

    def read(self, directory: Path) -> Map:
        """A map of which no file is larger than these settings allow."""
        from specmap_cli.maps.store import read_map

        return read_map(directory, self.load().limits)

    def overrides(self, flags: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The settings of `--set` and of the flags, nested.

        `flags` has the values of a command's own flags by dotted key, None for one not given.
        Raises UsageError for an assignment that is no KEY=VALUE.
        """
        nested: dict[str, Any] = {}
        for assignment in self.assignments or []:
            key, separator, text = (part.strip() for part in assignment.partition("="))
            hint = None
            if not separator or not all(key.split(".")):
                hint = "expected KEY=VALUE, such as grid.resolution_m=0.1"
            elif key == "preset":
                hint = f"choose a preset with --preset {text}"
            if hint is not None:
                raise UsageError(hint=hint, where=f"--set {assignment}", code=SETTING)
            from specmap_cli.core.toml import value_of

            _put(nested, key, value_of(text))  # which is a string if it is no TOML
        for key, value in (flags or {}).items():
            if value is not None:
                _put(nested, key, value)
        return nested


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings(Bounds):
    """The settings of a run: flags over the file over the preset over the defaults."""

    preset: Annotated[
        str | None,
        option(
            "default: what measures best; paper: the paper's own choices.", envvar="SPECMAP_PRESET"
        ),
    ] = None

    def of_map(self, stored: Map, flags: Mapping[str, Any] | None = None) -> Config:
        """Those that a map was built with, changed by these; UsageError for a wrong one."""
        from specmap_cli.pipelines.localizer import settings_for

        return settings_for(stored, self.overrides(flags), self.config, self.preset)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogSettings(Settings):
    """The settings of a run that reads a log: its topics and frames, too."""

    scan_topic: Annotated[str | None, option("Topic of the scans, when several fit.")] = None
    scan_frame: Annotated[
        str | None, option("Frame of the scans, when several lasers share a topic.")
    ] = None
    odom_topic: Annotated[str | None, option("Topic of the odometry, when several fit.")] = None
    base_frame: Annotated[str | None, option("Frame of the robot's base.")] = None
    no_odometry: Annotated[bool, option("Do not use odometry.", "--no-odometry")] = False

    def overrides(self, flags: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """The same, with the settings of section `log` that have options of their own."""
        if self.no_odometry and self.odom_topic is not None:
            raise UsageError("--odom-topic and --no-odometry do not go together")
        own = {
            "log.scan_topic": self.scan_topic,
            "log.scan_frame": self.scan_frame,
            "log.odom_topic": self.odom_topic,
            "log.base_frame": self.base_frame,
            "log.use_odometry": False if self.no_odometry else None,
        }
        return Bounds.overrides(self, {**own, **(flags or {})})


def cluster_of(workers: int | None, scheduler: str | None, common: Common) -> Cluster:
    """Where work is shared: `--workers` of this machine, or those of a `--scheduler`."""
    if workers is not None and scheduler is not None:
        raise UsageError("--workers and --scheduler do not go together: a scheduler has its own")
    if scheduler is not None and not scheduler.startswith("tls:"):
        common.progress().warn(
            f"{scheduler} does not use TLS: whoever reaches it can run code as you, see "
            "docs/security.md"
        )
    from specmap_cli.batch.workers import Cluster

    return Cluster(workers, scheduler)


@contextmanager
def _telling(common: Common) -> Iterator[None]:
    """A block in which each retired setting that was given has a line on stderr, once."""
    from specmap_cli.core.config import RetiredSetting

    def tell(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if issubclass(category, RetiredSetting):
            common.progress().warn(str(message))
        else:
            usual(message, category, *place)

    with warnings.catch_warnings():
        usual, warnings.showwarning = warnings.showwarning, tell  # type: ignore[assignment]
        warnings.simplefilter("default", RetiredSetting)  # a sentence once
        yield


def _put(tree: dict[str, Any], key: str, value: Any) -> None:
    """Set the entry of a dotted key; a value in the place of a section gives way to the section."""
    *sections, name = key.split(".")
    for section in sections:
        inner = tree.get(section)
        if not isinstance(inner, dict):
            inner = tree[section] = {}
        tree = inner
    tree[name] = value


_JOINT = "\x1f"  # no shell and no keyboard gives it


@functools.cache
def _options_in(group: type) -> list[Parameter]:
    """The fields of a group as parameters; read once, as all commands share them."""
    hints = get_type_hints(group, include_extras=True)
    return [
        field.replace(annotation=hints[field.name])
        for field in inspect.signature(group).parameters.values()
    ]


def unfolded(command: Callable[..., None]) -> Callable[..., None]:
    """`command` as Typer must see it: the fields of each group in the place of the group.

    A field without a default is required. Raises ValueError for two options of one name.
    """
    hints = get_type_hints(command, include_extras=True)
    groups = {
        name: hint for name, hint in hints.items() if isinstance(hint, type) and is_dataclass(hint)
    }
    parameters: list[Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        if name in groups:
            parameters += _options_in(groups[name])
        else:
            parameters.append(
                parameter.replace(kind=Parameter.KEYWORD_ONLY, annotation=hints[name])
            )

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{one.name: values.pop(one.name) for one in _options_in(group)})
        with _telling(values["common"]):
            command(**values)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


class JoinedCommand(TyperCommand):
    """A command that joins the values of such options before Typer sees them."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join what belongs to one use of an option: all up to another option; then parse."""
        options = {option for parameter in self.params for option in parameter.opts}
        several = {
            option: len(metavar.split())
            for parameter in self.params
            for option in parameter.opts
            if option.startswith("-") and " " in (metavar := parameter.metavar or "")
        }
        joined: list[str] = []
        rest = list(args)
        while rest:
            word = rest.pop(0)
            joined.append(word)
            if word == "--":
                break
            values = list(takewhile(lambda word: word not in options, rest[: several.get(word, 0)]))
            if values:
                del rest[: len(values)]
                joined.append(_JOINT.join(values))
        return super().parse_args(ctx, [*joined, *rest])


def uses_of(option: str, given: list[str] | None, names: str) -> Iterator[list[str]]:
    """The values of each use of an option; UsageError when there are not as many as `names`."""
    for joined in given or []:
        values = joined.split(_JOINT)
        if len(values) != len(names.split()):
            where = f"{option} {' '.join(values)}"
            raise UsageError(hint=f"expected {option} {names}", where=where)
        yield values


def check_files(
    outputs: Iterable[Path | None],
    inputs: Iterable[Path | None],
    common: Common,
    *,
    overwrite: bool = False,
) -> None:
    """Refuse files that exist (unless `overwrite`), whose place cannot be written, or that are
    needed: an input, or another output.

    What runs that were killed had begun to write in their places is removed, and told of. Raises
    UsageError naming the first file at fault; None stands for an output not asked for.
    """
    from specmap_cli.core.files import refuse_existing, remove_leftovers

    wanted = [path for path in outputs if path is not None]
    for path in wanted:
        if path.is_dir():
            raise UsageError("is a directory", "name the file to write", where=path)
        if os.path.lexists(path) and not path.is_file():
            raise UsageError("is no regular file", "choose another place", where=path, code=OUTPUT)
        if not overwrite:
            refuse_existing(path)
        if not path.parent.is_dir():
            raise UsageError(
                f"there is no directory {path.parent}", "make it first", where=path, code=OUTPUT
            )
        if not os.access(path.parent, os.W_OK):
            raise UsageError(
                f"cannot write in {path.parent}", "choose another place", where=path, code=OUTPUT
            )
    if len({path.resolve() for path in wanted}) < len(wanted):
        raise UsageError("given for two outputs: each needs a file of its own", where=wanted[0])
    keep_inputs(wanted, inputs)
    for output in wanted:
        with suppress(OSError):  # whoever writes the file is told of it
            for left in remove_leftovers(output):
                common.progress().note(
                    f"{output}: an earlier run was killed: removed {left.name}, which it had begun "
                    "to write"
                )


def keep_inputs(outputs: Iterable[Path], inputs: Iterable[Path | None]) -> None:
    """Refuse outputs that are an input, a directory with one inside, or a file of one that is a
    directory: it would be lost. None stands for an input that was not given. Raises UsageError.
    """
    needed = [path.resolve() for path in inputs if path is not None]
    for output in outputs:
        place = output.resolve()
        for path in needed:
            is_lost = path == place or place in path.parents
            if not is_lost and path in place.parents and place.is_file():
                from specmap_cli.maps.filenames import TOPOLOGY, is_of_a_map

                # a file of a map, or any file in a directory that is none
                inside = place.relative_to(path).as_posix()
                is_lost = not (path / TOPOLOGY).is_file() or is_of_a_map(inside)
            if is_lost:
                raise UsageError(
                    f"would replace the input {path}", "choose another output", where=output
                )
