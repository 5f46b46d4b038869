"""The places that led, scan by scan: a place that leads at last tells where the robot came from."""

from __future__ import annotations

from dataclasses import dataclass

from specmap_cli.core.geometry import Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.recognition.localization.place import Place


@dataclass(frozen=True, slots=True)
class Lead:
    """A place that leads all others, and its probability."""

    place: Place
    probability: float

    def at(self, map_from_base: Pose2) -> Lead:
        """The same lead at another scan of the track."""
        return Lead(self.place.moved(map_from_base), self.probability)


class Leads:
    """The leads of the scans of a log, in turn."""

    def __init__(self) -> None:
        self._scans: list[tuple[Pose2, Lead | None]] = []
        self._ends: list[bool] = []  # whether a track ended before the scan

    def add(self, posed: PosedScan, lead: Lead | None) -> None:
        """Take in the lead of the next scan, None where no place leads."""
        self._scans.append((posed.map_from_base, lead))
        self._ends.append(posed.restarted)

    def looking_back(self, reach_m: float) -> list[Lead | None]:
        """The lead of each scan, where it was; where none led, the next within `reach_m` of way.

        A loss of tracking ends a track: what comes after it says nothing of what was before.
        """
        filled: list[Lead | None] = []
        later: Lead | None = None
        way, after = 0.0, None
        for (map_from_base, lead), ends in zip(
            reversed(self._scans), reversed(self._ends), strict=True
        ):
            way += 0.0 if after is None else (map_from_base.inverse() @ after).distance
            if lead is not None:
                later, way = lead, 0.0
            near = later if way <= reach_m else None
            filled.append(None if near is None else near.at(map_from_base))
            after = None if ends else map_from_base
            later = None if ends else later
        return filled[::-1]
