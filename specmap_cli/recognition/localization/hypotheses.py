"""Places where the robot may be, each with what the walls have said of it so far."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from specmap_cli.core.geometry import Pose2
from specmap_cli.recognition.localization.place import Place
from specmap_cli.recognition.localization.wall_fit import Fitted

_HOPELESS = 8.0  # so much lighter than the heaviest: one in three thousand


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """The robot is where the last view was `fitted`.

    `weight` is the log likelihood of all views against their being from elsewhere. `refused` is the
    submap that the place would belong to, if its walls explained the view as well.
    """

    fitted: Fitted
    weight: float
    refused: int | None = None

    @property
    def place(self) -> Place:
        """The place that is followed."""
        return self.fitted.place

    @classmethod
    def born(cls, fitted: Fitted) -> Hypothesis:
        """A place that a search found, by its first view."""
        return cls(fitted, -fitted.against)

    def seen(self, fitted: Fitted, share: float, refused: int | None) -> Hypothesis:
        """After one more view, of which a `share` is new.

        All of it is, when the place begins to fit or no longer does.
        """
        share = share if fitted.fits == self.fitted.fits else 1.0
        return Hypothesis(fitted, self.weight - share * fitted.against, refused)


def bounded(hypotheses: Sequence[Hypothesis], most: float) -> list[Hypothesis]:
    """All lighter by what the heaviest has above `most`: what they differ by stays as it is."""
    over = max((each.weight for each in hypotheses), default=most) - most
    return [replace(each, weight=each.weight - max(0.0, over)) for each in hypotheses]


def worth_following(
    hypotheses: Iterable[Hypothesis], frames: Mapping[int, Pose2]
) -> list[Hypothesis]:
    """The hypotheses that are not far behind, the heaviest first, each place once.

    `frames` are the submaps' frames in the layout: a place may be known in two submaps.
    """
    kept: list[Hypothesis] = []
    for each in sorted(hypotheses, key=lambda h: -h.weight):
        if kept and each.weight < kept[0].weight - _HOPELESS:
            break
        if not any(each.place.is_same(other.place, frames) for other in kept):
            kept.append(each)
    return kept
