"""The recordings that stand for the paper's two: real ones, and simulated ones of the same kind.

The paper's first building, Freiburg, is rooms on a corridor that the robot keeps coming back to;
its second, the Stata Center, is closed by one large loop. The paper simulated both from their
maps; here the recordings of the two buildings are real, where SPECMAP_DATA has them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from benchmarks.data import TRUTH, plan, rooms_of
from benchmarks.paper import ring
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.grids.map_server import read_grid
from specmap_cli.pipelines.simulate import simulate
from specmap_cli.simulation.simulator import SimulationOptions
from specmap_cli.simulation.worlds import RoomTruth, read_rooms

FREIBURG, STATA = "Freiburg", "Stata"
SAMPLES = Path(__file__).parent.parent.parent / "sample_logs"
REAL = {"fr079": FREIBURG, "mit_csail": STATA}
FREIBURG_PLAN = "Freiburg79_scan"
# What SPECMAP_DATA may lack, by name.
LACKING = {
    "fr079": "Freiburg's building 079 (logs/fr079.mcap, truth/fr079_corrected.tum)",
    "mit_csail": "the Stata Center (logs/mit_csail.mcap, truth/mit_csail_corrected.tum)",
    "plans": "the plans drawn by hand (rooms/)",
}
_TOUR = SimulationOptions(beams=181, speed_mps=0.8, spacing_m=3.0, rate_hz=5.0)


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """A plan with its rooms, a number each."""

    plan: GridMap
    rooms: RoomTruth


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Case:
    """A recording in the manner of one of the paper's buildings.

    `log` and `truth` (poses of the laser or of the base, TUM) are files, which `make` writes if
    they are simulated. `drawing` is of the building. `again` is another way through it.
    """

    name: str
    manner: str
    log: Path
    truth: Path
    make: Callable[[], object] | None = None
    drawing: Drawing | None = None
    again: Case | None = None

    def ready(self) -> Case:
        """The same, its files written."""
        if self.make is not None and not self.log.exists():
            self.make()
        return self


@dataclass(frozen=True, slots=True)
class Cases:
    """All recordings that are at hand, the names of plans drawn by hand; what of LACKING is not."""

    found: tuple[Case, ...]
    plans: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()


def cases(folder: Path) -> Cases:
    """The recordings; the simulated ones are written to `folder` when they are needed."""
    simulated = (office(), ring_case(folder))
    data = _data()
    if data is None:
        return Cases(simulated, missing=tuple(LACKING))
    real = {name: _real(data, name, manner) for name, manner in REAL.items()}
    here = {n: case for n, case in real.items() if case.log.exists() and case.truth.exists()}
    missing = [name for name in real if name not in here]
    plans = [path.name.removesuffix(TRUTH) for path in sorted((data / "rooms").glob("*" + TRUTH))]
    drawn = (freiburg(folder),) if FREIBURG_PLAN in plans else ()
    if not drawn:
        missing.append("plans")
    return Cases((*here.values(), *drawn, *simulated), tuple(plans), tuple(missing))


def office() -> Case:
    """The sample logs of this project: rooms on a corridor, twice."""
    drawing = Drawing(
        read_grid(SAMPLES / "office.yaml"), read_rooms(SAMPLES / "office_rooms.png", 0.05)
    )
    again, first = (
        Case(
            name="office, simulated",
            manner=FREIBURG,
            log=SAMPLES / f"{name}.mcap",
            truth=SAMPLES / f"{name}.tum",
            drawing=drawing,
        )
        for name in ("office_again", "office")
    )
    return replace(first, again=again)


def ring_case(folder: Path) -> Case:
    """The building of `ring`, two laps; another way through it."""
    drawing = Drawing(ring.plan(), ring.rooms())
    return tour("ring, simulated", STATA, drawing, folder)


def freiburg(folder: Path) -> Case:
    """Freiburg's building 079 as the paper had it: simulated from its plan."""
    drawing = Drawing(plan(FREIBURG_PLAN), rooms_of(FREIBURG_PLAN))
    return tour("Freiburg79, simulated", FREIBURG, drawing, folder)


def tour(
    name: str,
    manner: str,
    drawing: Drawing,
    folder: Path,
    options: SimulationOptions = _TOUR,
) -> Case:
    """Two laps through a drawing, and one by another way, to be simulated when they are needed."""
    stem = name.partition(",")[0].lower()
    laps = ({"laps": 2, "seed": 1}, {"laps": 1, "seed": 7})
    first, again = (
        Case(
            name=name,
            manner=manner,
            log=folder / f"{stem}_{k}.mcap",
            truth=folder / f"{stem}_{k}.tum",
            make=partial(
                simulate, drawing.plan, options.model_copy(update=lap), folder / f"{stem}_{k}.mcap"
            ),
            drawing=drawing,
        )
        for k, lap in enumerate(laps)
    )
    return replace(first, again=again)


def _real(data: Path, name: str, manner: str) -> Case:
    return Case(
        name=f"{name}, real",
        manner=manner,
        log=data / "logs" / f"{name}.mcap",
        truth=data / "truth" / f"{name}_corrected.tum",
    )


def _data() -> Path | None:
    """The folder with the data, if there is one."""
    folder = Path(os.environ.get("SPECMAP_DATA", "../shared/data"))
    return folder if (folder / "logs").is_dir() else None
