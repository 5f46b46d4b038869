"""Registration methods for tests: one that does nothing by itself, one that does as it is told."""

from collections.abc import Callable, MutableMapping
from dataclasses import dataclass, field
from typing import cast

import pytest

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.registration import SensorKind
from specmap_cli.registration.aligner import BUILT_IN, AlignerFactory


@dataclass
class ToldAligner:
    """Answers what `answer` makes of the guess, and remembers what it was given."""

    answer: Callable[[FloatArray], FloatArray] = lambda guess: guess
    kernels_m: list[float] = field(default_factory=list)  # of all alignments
    inserted: list[tuple[FloatArray, FloatArray]] = field(default_factory=list)
    cleared: int = 0
    sensors: list[SensorKind] = field(default_factory=list)  # that one was made for

    def insert(self, points: FloatArray, map_from_base: FloatArray) -> None:
        self.inserted.append((points, map_from_base.copy()))

    def clear(self) -> None:
        self.cleared += 1

    def align(
        self, points: FloatArray, guess: FloatArray, kernel_m: float, *, coarse: bool
    ) -> FloatArray:
        del points, coarse  # the answer is the same for all
        self.kernels_m.append(kernel_m)
        return self.answer(guess)


def offer(monkeypatch: pytest.MonkeyPatch, aligner: ToldAligner) -> str:
    """Make an aligner a registration method for one test; returns the method's name."""

    def factory(config: RegistrationConfig, sensor: SensorKind) -> ToldAligner:
        assert config.method == "told"
        aligner.sensors.append(sensor)
        return aligner

    monkeypatch.setitem(cast("MutableMapping[str, AlignerFactory]", BUILT_IN), "told", factory)
    return "told"
