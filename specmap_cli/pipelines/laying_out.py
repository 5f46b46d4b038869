"""The layout of what was explored: relaxed, turned, healed, and the closures that it refutes."""

from __future__ import annotations

from dataclasses import dataclass

from specmap_cli.core.progress import Progress
from specmap_cli.core.records import Closure, Trajectory
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.layout.audit import Audited, repaired
from specmap_cli.layout.main_direction import along_walls
from specmap_cli.layout.relaxation import relax
from specmap_cli.layout.result import Layout
from specmap_cli.layout.trajectory import corrected
from specmap_cli.pipelines.exploration import Explored
from specmap_cli.pipelines.refutation import constraints_of, refute
from specmap_cli.pipelines.stopwatch import Stopwatch


@dataclass(frozen=True, slots=True)
class LaidOut:
    """A layout with its audit, the trajectory of all scans in it, and the closures it leaves."""

    audited: Audited
    trajectory: Trajectory
    closures: tuple[Closure, ...]

    @property
    def layout(self) -> Layout:
        """The poses of all keyframes and their pose graph."""
        return self.audited.layout


def lay_out(
    explored: Explored, config: Config, store: KeyframeStore, progress: Progress, clock: Stopwatch
) -> LaidOut:
    """Relax what was tracked by the closures, turn it along the walls, heal, refute the rest."""
    progress.start("layout", None)
    with clock.stage("layout"):
        constraints = constraints_of(explored.closures, explored.regions, store)
        layout = relax(store, tuple(constraints.values()), explored.breaks, config.relaxation)
        layout = along_walls(layout, store, config.relaxation)
    with clock.stage("audit"):
        audited = repaired(store, layout, explored.breaks)
        trajectory = corrected(explored.trajectory, store, audited.layout.poses)
    closures = refute(explored.closures, constraints, audited.layout)
    return LaidOut(audited, trajectory, closures)
