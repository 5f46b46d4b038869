"""A map is founded when a second sweep fits its first one; until then its scans are held back.

A first sweep that was spoiled, by a person before the laser or a driver that starts, would else be
the truth that all others are lost against.
"""

from __future__ import annotations

from dataclasses import replace

from specmap_cli.core.records import PosedScan


class Founding:
    """Holds back the scans of a map that is not founded yet, at most `most` of them."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._held: list[PosedScan] = []
        self._refuted: tuple[PosedScan, ...] = ()
        self._restarts = False

    def refute(self) -> int:
        """The map of the scans held is given up: they are lost. Returns how many were not before.

        Where they restarted the map after a break, the next one does.
        """
        believed = sum(not scan.lost for scan in self._held)
        self._restarts = self._restarts or any(scan.restarted for scan in self._held)
        lost = (replace(scan, lost=True, restarted=False) for scan in self._held)
        self._refuted, self._held = (*self._refuted, *lost), []
        return believed

    def handed_on(self, scan: PosedScan, *, founded: bool) -> tuple[PosedScan, ...]:
        """The scans that are settled now that this one was registered, in their order."""
        if self._restarts and not scan.lost:
            scan, self._restarts = replace(scan, restarted=True), False
        self._held.append(scan)
        settled, self._refuted = self._refuted, ()
        if founded or len(self._held) >= self._most:
            settled = (*settled, *self.rest())
        return settled

    def rest(self) -> tuple[PosedScan, ...]:
        """The scans that are held, which no later one will settle."""
        held, self._held = tuple(self._held), []
        return held
