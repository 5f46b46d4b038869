"""Localisation: in which submap was each scan of another log taken? (Section IV-B, Figure 6)"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice

import numpy as np

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PosedScan
from specmap_cli.core.settings import LocalizationConfig
from specmap_cli.grids.gridmap import GridMap
from specmap_cli.recognition.features.virtual import WINDOW_M
from specmap_cli.recognition.learning.calibration import steadiness
from specmap_cli.recognition.learning.classifiers import ClassifierSet
from specmap_cli.recognition.localization.classification import ClassifiedScan, ScanClassifier
from specmap_cli.recognition.localization.filtering import (
    SMALLEST,
    HiddenMarkovFilter,
    ViewGrouping,
)
from specmap_cli.recognition.localization.metric import MetricTracker
from specmap_cli.recognition.localization.places import LeadingPlace, Owners, looking_back
from specmap_cli.recognition.localization.tracking import PlaceTracker
from specmap_cli.recognition.localization.unknown import UnknownOdds, WallCheck
from specmap_cli.recognition.localization.wall_fit import Ratio, Surroundings, WallFit

_STRANGE_ALONE = 1.0  # a single scan is unknown beyond this share of the limit
_TOGETHER = 32  # scans whose features are computed at once


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """Where one scan was taken; a submap of None means unknown: nothing fits.

    `margin` is the winner's margin over `runner_up`'s in the raw vote, `probability` how likely it
    is by this scan alone, if the scan is from the map. The filtered label uses all scans so far
    (all scans of the log after smoothing) and has a probability, too.
    """

    stamp_ns: int
    submap: int | None
    margin: float
    runner_up: int | None
    filtered_submap: int | None
    filtered_probability: float
    probability: float


class Localizer:
    """Labels the scans of a log in turn, by the classifiers and topology of a map.

    `frames` are the submaps' frames in the layout: they say where a robot comes out that drives
    from one submap into another. `tracks` (n, 2 or more) are where the keyframes of each submap
    are in the map: they say where one submap ends. `metric` asks for places even where walls do not
    count for the labels.
    """

    def __init__(
        self,
        classifiers: ClassifierSet,
        adjacency: Mapping[int, Collection[int]],
        grids: Mapping[int, GridMap],
        config: LocalizationConfig,
        frames: Mapping[int, Pose2] | None = None,
        tracks: Mapping[int, FloatArray] | None = None,
        *,
        metric: bool = False,
    ) -> None:
        self.classifiers = classifiers
        self.config = config
        self.filter = HiddenMarkovFilter({i: adjacency.get(i, ()) for i in classifiers.ids}, config)
        self._classifier = ScanClassifier(classifiers, config)
        frames = frames or {}
        around = Surroundings(grids, adjacency, frames)
        self.tracker = MetricTracker(around.field, frames)
        ratio = Ratio(classifiers.misfit, config)
        fit = WallFit(grids, around, ratio, frames)
        owners = Owners(tracks or {}, frames, grids)
        self.places = PlaceTracker(self.filter.ids, fit, owners, config)
        # Whether a view is of the map at all is told best by the walls that each submap saw itself.
        alone = WallFit(grids, Surroundings(grids, {}, frames), ratio, frames)
        self.walls = WallCheck(alone, config)
        self._uses_walls = metric or config.unknown
        self._unknown = UnknownOdds(self.walls, config)
        self._views = ViewGrouping()
        self._labels: list[Label] = []
        self._leads: list[tuple[Pose2, bool, LeadingPlace | None]] = []

    @property
    def note(self) -> str:
        """How the log's laser is made to fit the classifiers; empty when it is the same."""
        return self._classifier.note

    def labelled(self, scans: Iterable[PosedScan]) -> Iterator[tuple[PosedScan, Label]]:
        """The next scans, each with its label, some read ahead: many at once are cheaper to see.

        Raises InputError when their laser sees too little.
        """
        left = iter(scans)
        while some := list(islice(left, _TOGETHER)):
            for posed, scan in zip(some, self._classifier.classified(some), strict=True):
                yield posed, self._update(posed, scan)

    def update(self, posed: PosedScan) -> Label:
        """The label of the next scan. Raises InputError when its laser sees too little."""
        return self._update(posed, self._classifier.classified([posed])[0])

    def _update(self, posed: PosedScan, scan: ClassifiedScan) -> Label:
        """The label of a scan: what is said of its view, the filter, then the places."""
        if posed.restarted:
            self._unknown.restart()
            self._views.restart()
            self.filter.reset()
            self.places.restart()
        again = not self._views.begins(posed)
        known = self._views.mean(scan.all)
        known = min(1.0, self._views.motion / steadiness(known)) * known
        worth = -math.inf
        if self._uses_walls:
            # the submap first that is likeliest by all scans, then by this one's margins
            before = np.maximum(self.filter.predicted(again)[:-1], SMALLEST)
            by_all = scan.all + np.log(before)
            ranked = [int(by_all.argmax()), *np.argsort(-scan.all, kind="stable").tolist()]
            likely = [self.filter.ids[k] for k in dict.fromkeys(ranked)]
            worth = self._unknown.worth(posed, scan, likely, again)
        log_likelihoods = np.append(known, -math.inf)
        if self.config.unknown:
            log_likelihoods = self.filter.with_unknown(known, worth, again)
        belief = self.filter.update(log_likelihoods, again)
        by_places = self.places.update(posed, self.walls.view, belief[:-1])
        belief = np.append(by_places, belief[-1])
        label = self._filtered(self._raw_label(posed.stamp_ns, scan), belief)
        self._labels.append(label)
        self._leads.append((posed.map_from_base, posed.restarted, self.places.lead))
        self._views.keep(log_likelihoods)
        return label

    def smoothed(self) -> list[Label]:
        """All labels so far, the filtered ones given the whole track that they belong to.

        And what a lead says of the submap.
        """
        labels = []
        beliefs = self._views.of_scans(self.filter.smooth)
        for label, belief, lead in zip(self._labels, beliefs, self.leads(), strict=True):
            led = belief
            if lead is not None and self.places.owners.known:
                led = (1.0 - lead.probability) * belief
                owner = self.places.owners.of(lead.place.submap, lead.place.pose)
                led[self.filter.ids.index(owner)] += lead.probability * float(belief[:-1].sum())
                led[-1] = belief[-1]
            labels.append(self._filtered(label, led))
        return labels

    def leads(self) -> list[LeadingPlace | None]:
        """The place that leads at each scan so far, or that leads later and tells of it."""
        return looking_back(self._leads, WINDOW_M)

    def _raw_label(self, stamp_ns: int, scan: ClassifiedScan) -> Label:
        """The label of the single scan by the most votes; nothing is filtered yet."""
        order = np.argsort(-scan.margins, kind="stable")
        ids, margins = self.filter.ids, scan.margins[order]
        # of no place is what fits no walls or, if that is not known, what is strange
        of_walls = self._unknown.of_walls
        strange = scan.strange > _STRANGE_ALONE if of_walls is None else of_walls > 0.0
        known = not (self.config.unknown and strange)
        return Label(
            stamp_ns=stamp_ns,
            submap=ids[order[0]] if known else None,
            margin=float(margins[0]) - (float(margins[1]) if len(order) > 1 else 0.0),
            runner_up=ids[order[1]] if len(order) > 1 else None,
            filtered_submap=None,
            filtered_probability=0.0,
            probability=math.exp(scan.raw[order[0]]),
        )

    def _filtered(self, label: Label, belief: FloatArray) -> Label:
        """The label with the most likely submap; unknown, the last state, where none is so likely.

        That is when all submaps together are less likely than it.
        """
        unknown = len(self.filter.ids)
        state = unknown if belief[unknown] > belief[:unknown].sum() else int(belief[:-1].argmax())
        submap = self.filter.ids[state] if state < unknown else None
        probability = float(belief[state])
        return replace(label, filtered_submap=submap, filtered_probability=probability)
