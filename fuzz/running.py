"""Commands of specmap run inside this process, with what they print and how they end."""

from __future__ import annotations

import faulthandler
import os
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib import import_module, metadata
from typing import IO, Any, NamedTuple

import typer.main

import specmap_cli.cli.app as application
from specmap_cli.cli import main
from specmap_cli.core import plugins


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """How a command ended: its exit code, what it wrote, and the bug that it raised."""

    arguments: tuple[str, ...]
    code: int
    stdout: str
    stderr: str
    bug: BaseException | None = None


class Printed(NamedTuple):
    """What went to file descriptors 1 and 2, whoever wrote it."""

    stdout: str
    stderr: str


def run_command(arguments: Sequence[str]) -> Run:
    """Run `specmap ARGUMENTS` here. Ends like the program: every error has an exit code."""
    code, bug = 1, None
    with captured() as printed:
        try:
            code = main(list(arguments))
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else 1
        except Exception as error:
            bug = error
    out = printed()
    return Run(arguments=tuple(arguments), code=code, stdout=out.stdout, stderr=out.stderr, bug=bug)


@contextmanager
def captured() -> Iterator[Any]:
    """Catch what is written to stdout and stderr in the block, by C libraries, too.

    What the block gets is a function that tells, afterwards, what was written.
    """
    with tempfile.TemporaryFile(dir=_PLACE) as out, tempfile.TemporaryFile(dir=_PLACE) as err:
        with _redirected(1, out, "stdout"), _redirected(2, err, "stderr"):
            texts: list[Printed] = []
            yield lambda: texts[0]
        texts.append(Printed(stdout=_text(out), stderr=_text(err)))


_PLACE = tempfile.gettempdir()  # not that of a case, whose emptiness is checked


@contextmanager
def _redirected(descriptor: int, target: IO[bytes], name: str) -> Iterator[None]:
    kept, stream = os.dup(descriptor), getattr(sys, name)
    os.dup2(target.fileno(), descriptor)
    own = os.fdopen(descriptor, "w", encoding="utf-8", errors="surrogateescape", closefd=False)
    setattr(sys, name, own)
    try:
        yield
    finally:
        own.close()
        setattr(sys, name, stream)
        os.dup2(kept, descriptor)
        os.close(kept)


def _text(file: IO[bytes]) -> str:
    file.seek(0)
    return file.read().decode("utf-8", errors="backslashreplace")


def place_of(error: BaseException) -> str:
    """Kind of an error and the last line of specmap's that it came through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if "specmap_cli" in frame.filename] or frames
    where = ""
    if own:
        file = own[-1].filename.partition("specmap_cli/")[2] or own[-1].filename
        where = f" at {file}:{own[-1].name}"
    return f"{type(error).__name__}{where}: {str(error)[:120]}"


def prepare() -> None:
    """Do once for the process what every command would do again: it stays the same all the time.

    That is the parsing of the commands' own signatures and the search for installed packages.
    """
    warnings.simplefilter("always")  # each case shall have its own, whatever went before
    faulthandler.disable()  # it would write to the stderr of the tests
    setattr(typer.main, "get_command", cache(typer.main.get_command))  # noqa: B010
    setattr(plugins, "entry_points", cache(metadata.entry_points))  # noqa: B010


def preload() -> None:
    """Import what the commands import late, so that every worker runs the same program."""
    for module in ("build", "localize"):
        import_module(f"specmap_cli.pipelines.{module}")
    import_module("specmap_cli.logs.writer")
    import_module("specmap_cli.logs.inspection")


def has_command(name: str) -> bool:
    """Whether specmap has a command of this name."""
    return any(command.name == name for command in application.app.registered_commands)
