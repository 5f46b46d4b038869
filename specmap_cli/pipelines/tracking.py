"""Scan matching a whole log: every sweep registered in turn, and how it went."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from dataclasses import dataclass

from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.core.text import counted
from specmap_cli.logs.planar import Repeats
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.registration.frontend import FrontEnd


@dataclass(frozen=True, slots=True, kw_only=True)
class Tracking:
    """What reading and registration have to tell at the end of a log.

    `counts` are of messages and of scans, `seconds` those of registration alone.
    """

    counts: Mapping[str, int]
    warnings: tuple[str, ...]
    seconds: float


def track(stream: SweepStream, config: RegistrationConfig) -> Generator[PosedScan, None, Tracking]:
    """Yield every scan of a log with its pose; return how it went.

    Scans that a hanging driver repeats say nothing of where the robot is: they are left out.
    """
    front_end, clock, repeats = FrontEnd(config), Stopwatch(), Repeats()
    stale = 0
    for sweep in stream:
        if repeats.stale(sweep):
            stale += 1
            continue
        with clock.stage("registration"):
            scans = front_end.take(sweep)
        yield from scans
    yield from front_end.rest()
    return Tracking(
        counts={**stream.counts, **front_end.counts, "stale_scans": stale},
        warnings=(*stream.warnings, *_told(stale), *front_end.warnings),
        seconds=clock.seconds.get("registration", 0.0),
    )


def _told(stale: int) -> list[str]:
    if not stale:
        return []
    return [
        f"{counted(stale, 'scan')} repeat the one before although odometry says that the robot "
        "moved, and were left out: the driver of the laser hung"
    ]
