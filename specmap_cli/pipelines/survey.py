"""A recording explored and laid out by itself, before it meets a map that is there."""

from __future__ import annotations

from dataclasses import dataclass

from specmap_cli.core.progress import Progress
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.layout.audit import Audited
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import explore_log, refuse_empty
from specmap_cli.pipelines.exploration import Exploration
from specmap_cli.pipelines.kept_map import Seen, seen_of_log
from specmap_cli.pipelines.laying_out import lay_out
from specmap_cli.pipelines.stopwatch import Stopwatch
from specmap_cli.pipelines.tracking import Tracking
from specmap_cli.recognition.features.sets import KeyframeFeatures


@dataclass(frozen=True, slots=True)
class Survey:
    """A recording as a kept map, the audit of its layout, and what tracking counted.

    `features` are those of its keyframes that are known by now.
    """

    seen: Seen
    audited: Audited
    tracking: Tracking
    features: KeyframeFeatures


def survey(
    stream: SweepStream,
    config: Config,
    store: KeyframeStore,
    progress: Progress,
    clock: Stopwatch,
) -> Survey:
    """A recording explored and laid out by itself, its keyframes in `store`.

    Raises NoResultError when it left no keyframe, or none that fits the grid.
    """

    def begin() -> Exploration:
        return Exploration(config, store, clock, None)

    accepts = KeyframeSelector(config.keyframes).accepts
    explored, tracking = explore_log(stream, config, begin, accepts, progress)
    refuse_empty(store, stream, tracking)
    laid = lay_out(explored, config, store, progress, clock)
    with clock.stage("grids"):
        seen = seen_of_log(explored, laid, stream.log.name, tracking.warnings, store, config)
    return Survey(seen, laid.audited, tracking, explored.features)
