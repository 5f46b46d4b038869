"""What several parts of the page need, made once: registered recordings, and maps of them."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.paper.cases import Case, Cases, Drawing
from specmap_cli.core.config import load_config
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import Config
from specmap_cli.evaluation.protocols import HoldOut, HoldOutResult, holding_out, score_hold_out
from specmap_cli.grids.keyframes import KeyframeSelector, KeyframeStore
from specmap_cli.logs import open_log
from specmap_cli.logs.stream import SweepStream
from specmap_cli.pipelines.build import Accepts, explore
from specmap_cli.pipelines.exploration import Exploration
from specmap_cli.pipelines.finishing import finish
from specmap_cli.pipelines.laying_out import lay_out
from specmap_cli.pipelines.learning import Prior
from specmap_cli.pipelines.map_in_making import Explored, FinishedMap
from specmap_cli.pipelines.session import Session
from specmap_cli.pipelines.tracking import Tracking, track
from specmap_cli.segmentation.online import Observer, Occasion, SplitTest

PAPER, OURS = "paper", "default"
PRESETS = (PAPER, OURS)
WORDS = {PAPER: "the paper's choices", OURS: "specmap's choices"}


def beside(told: Mapping[str, str]) -> str:
    """A sentence of what each preset shows."""
    said = "; ".join(f"{WORDS[preset]}: {words}" for preset, words in told.items())
    return f"{said[0].upper()}{said[1:]}."


@dataclass(frozen=True, slots=True)
class Recording:
    """The registered scans of a recording, and how registration went."""

    scans: tuple[PosedScan, ...]
    tracking: Tracking


@dataclass(frozen=True, slots=True)
class Test:
    """A test that may split a submap: its eigenvalue, whether it split, and when."""

    eigenvalue: float
    second: float
    split: bool
    occasion: Occasion


@dataclass(frozen=True, slots=True, kw_only=True)
class Built:
    """A map of a recording with one preset, how Algorithm 1 came to it, and what was held out."""

    config: Config
    store: KeyframeStore
    held_out: KeyframeStore
    explored: Explored
    finished: FinishedMap
    tests: tuple[Test, ...]

    def scores(self) -> HoldOutResult:
        """Table II: the scans of the map and those held out, labelled."""
        return score_hold_out(self.finished, self.store, self.held_out, self.config)


@dataclass(slots=True)
class Workshop:
    """Registers each recording once and builds each map once; closes what it keeps at the end."""

    cases: Cases
    _recordings: dict[Path, Recording] = field(default_factory=dict)
    _built: dict[tuple[Path, str, HoldOut | None], Built] = field(default_factory=dict)
    _stores: ExitStack = field(default_factory=ExitStack)

    def __enter__(self) -> Workshop:
        return self

    def __exit__(self, *_: object) -> None:
        self._stores.close()

    def of_manner(self, manner: str) -> list[Case]:
        """The recordings in the manner of one of the paper's buildings."""
        return [case for case in self.cases.found if case.manner == manner]

    def drawn(self, manner: str) -> list[tuple[Case, Drawing]]:
        """Those of them whose rooms are drawn, with the drawings."""
        return [(case, case.drawing) for case in self.of_manner(manner) if case.drawing is not None]

    def recording(self, case: Case) -> Recording:
        """The registered scans of a recording: "registering them using scan matching"."""
        log = case.ready().log
        if log not in self._recordings:
            self._recordings[log] = _registered(log)
        return self._recordings[log]

    def built(self, case: Case, preset: str, held_out: HoldOut | None = None) -> Built:
        """The map of a recording, without the keyframes that `held_out` lays aside."""
        key = case.log, preset, held_out
        if key not in self._built:
            store, aside = (self._stores.enter_context(KeyframeStore()) for _ in range(2))
            self._built[key] = _build(self.recording(case), preset, held_out, store, aside)
        return self._built[key]


def _registered(log: Path) -> Recording:
    config = load_config()
    with open_log([log], config.log) as opened:
        scans = track(SweepStream(opened, config.log), config.registration)
        kept = []
        while True:
            try:
                kept.append(next(scans))
            except StopIteration as end:
                return Recording(tuple(kept), end.value)


def _build(
    recording: Recording,
    preset: str,
    held_out: HoldOut | None,
    store: KeyframeStore,
    aside: KeyframeStore,
) -> Built:
    config = load_config(preset=preset)
    session = Session(config, store)
    tests: list[Test] = []
    accepts: Accepts = KeyframeSelector(config.keyframes).accepts
    if held_out is not None:
        accepts = holding_out(config.keyframes, held_out, aside)
    explored = explore(recording.scans, Exploration(session, _noting(tests)), accepts)
    laid = lay_out(session, explored, recording.tracking, "recording")
    finished = finish(session, laid, Prior(explored.features))
    return Built(
        config=config,
        store=store,
        held_out=aside,
        explored=explored,
        finished=finished,
        tests=tuple(tests),
    )


def _noting(tests: list[Test]) -> Observer:
    """An observer that remembers every test's figures, and not its map."""

    def note(test: SplitTest, split: bool, occasion: Occasion) -> None:
        second = float(test.eigenvalues[1]) if len(test.eigenvalues) > 1 else 0.0
        tests.append(Test(test.eigenvalue, second, split, occasion))

    return note
