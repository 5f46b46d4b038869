"""The paper by one command: every table and figure of it on one page, computed anew.

    python -m benchmarks.paper [--only figure2 table2 ...] [-o DIR]

Brunskill, Kollar and Roy (IROS 2007), with the paper's choices (`--preset paper`) and with ours,
on the real recordings of $SPECMAP_DATA and on simulated ones of the same kind, which need nothing.
The page is DIR/index.html; the processor seconds of each part are printed.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2

from benchmarks.paper.cases import cases
from benchmarks.paper.page import Done, render
from benchmarks.paper.parts import PARTS, Part
from benchmarks.paper.workshop import Workshop
from specmap_cli.core.process import one_blas_thread

_DEFAULT = Path("paper")


def main() -> None:
    names = [part.name for part in PARTS]
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--only", nargs="+", choices=names, default=names, metavar="FIGURE")
    parser.add_argument("-o", "--out", type=Path, default=_DEFAULT, help="folder of the page")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    arguments.out.mkdir(parents=True, exist_ok=True)
    chosen = [part for part in PARTS if part.name in arguments.only]
    with (
        tempfile.TemporaryDirectory(prefix="specmap-") as folder,
        Workshop(cases(Path(folder))) as workshop,
        one_blas_thread(),
    ):
        done = [_made(part, workshop) for part in chosen]
    page = arguments.out / "index.html"
    page.write_text(render(done, workshop.cases, _command(chosen)), encoding="utf-8")
    print(f"{'all':9} {sum(part.seconds for part in done):7.1f} s\n{page}")


def _made(part: Part, workshop: Workshop) -> Done:
    started = _processor_s()
    blocks = part.make(workshop)
    done = Done(part, blocks, _processor_s() - started)
    print(f"{part.name:9} {done.seconds:7.1f} s", flush=True)
    return done


def _processor_s() -> float:
    """Processor seconds of this process and of those it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


def _command(chosen: Sequence[Part]) -> str:
    only = "" if len(chosen) == len(PARTS) else " --only " + " ".join(p.name for p in chosen)
    return f"python -m benchmarks.paper{only}"


if __name__ == "__main__":
    main()
