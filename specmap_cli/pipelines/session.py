"""What travels with a map in the making: its keyframes, the settings, the progress and the time."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from specmap_cli.core.progress import Progress, Silent
from specmap_cli.core.settings import Config
from specmap_cli.grids.keyframes import KeyframeStore


class Stopwatch:
    """Adds up the seconds spent in named stages; a stage inside another is not counted twice."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._running: list[str] = []
        self._since = self.began = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the block as `name`, pausing the stage around it."""
        self._lap()
        self._running.append(name)
        try:
            yield
        finally:
            self._lap()
            self._running.pop()

    def _lap(self) -> None:
        now = time.perf_counter()
        if self._running:
            name = self._running[-1]
            self.seconds[name] = self.seconds.get(name, 0.0) + now - self._since
        self._since = now


@dataclass(frozen=True, slots=True)
class Session:
    """The settings and the keyframes of a map in the making, who is told of it, and the seconds."""

    config: Config
    store: KeyframeStore
    progress: Progress = field(default_factory=Silent)
    clock: Stopwatch = field(default_factory=Stopwatch)  # its stages are told in run.json
