"""Charts as drawings in a page: where axes, lines and dots stand."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor, log10

from benchmarks.paper.blocks import Chart

WIDTH, HEIGHT = 860, 310
_LEFT, _RIGHT, _TOP, _BOTTOM = 56, 16, 26, 44
_TICKS = 5


@dataclass(frozen=True, slots=True)
class Tick:
    """A mark on an axis: where, and its figure."""

    at: float
    text: str


@dataclass(frozen=True, slots=True)
class Line:
    """A series drawn: the points of its line, its dots (x, y, filled), its level."""

    name: str
    points: str
    dots: tuple[tuple[float, float, bool], ...]
    level: float | None


@dataclass(frozen=True, slots=True)
class Drawn:
    """A chart as numbers of pixels."""

    chart: Chart
    across: tuple[Tick, ...]
    up: tuple[Tick, ...]
    lines: tuple[Line, ...]
    left: int = _LEFT
    right: int = WIDTH - _RIGHT
    top: int = _TOP
    bottom: int = HEIGHT - _BOTTOM
    width: int = WIDTH
    height: int = HEIGHT


def drawn(chart: Chart) -> Drawn:
    """The drawing of a chart; both axes begin at nought, and what lies beyond one lies on it."""
    xs = [x for series in chart.series for x, _ in series.points]
    ys = [y for series in chart.series for _, y in series.points]
    wide, high = max([*xs, 1e-9]), chart.top or max([*ys, 1e-9])

    def across(x: float) -> float:
        return round(_LEFT + (WIDTH - _LEFT - _RIGHT) * x / wide, 1)

    def up(y: float) -> float:
        return round(
            HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * min(max(y, 0.0), high) / high, 1
        )

    lines = [
        Line(
            series.name,
            " ".join(f"{across(x)},{up(y)}" for x, y in series.points),
            tuple(
                (across(x), up(y), number in series.marked)
                for number, (x, y) in enumerate(series.points)
            ),
            None if series.level is None else up(series.level),
        )
        for series in chart.series
    ]
    return Drawn(
        chart,
        tuple(Tick(across(x), f"{x:g}") for x in ticks(wide)),
        tuple(Tick(up(y), f"{y:g}") for y in ticks(high)),
        tuple(lines),
    )


def ticks(most: float) -> list[float]:
    """Round numbers from nought to `most`, some five of them."""
    rough = most / _TICKS
    power = 10.0 ** floor(log10(rough))
    step = next(step for step in (1.0, 2.0, 2.5, 5.0, 10.0) if step * power >= rough) * power
    return [round(k * step, 9) for k in range(int(most / step + 1e-9) + 1)]
