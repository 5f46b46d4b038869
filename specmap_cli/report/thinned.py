"""What a page leaves out of a large map, in words."""

from __future__ import annotations

from specmap_cli.core.text import counted
from specmap_cli.report.layers import Closures
from specmap_cli.report.spectra import Spectra
from specmap_cli.report.track import Track


def thinned(track: Track, spectra: Spectra, closures: Closures) -> list[str]:
    """A sentence for each part of the map that is not shown whole."""
    found = ["Outlines are simplified by half a cell; places are rounded to centimetres."]
    if len(track.seconds) < track.known:
        kept, known = len(track.seconds), counted(track.known, "keyframe")
        found.append(f"The way is drawn through {kept:,} of {known}, evenly spread.")
    if len(spectra.dots) < spectra.known:
        kept, known = len(spectra.dots), counted(spectra.known, "split test")
        found.append(f"Of {known} {kept:,} are shown, those that split a submap first.")
    if spectra.thinned:
        found.append("Split tests show some of their nodes, evenly spread.")
    if len(closures.refused) < closures.refused_known:
        kept, known = len(closures.refused), f"{closures.refused_known:,} refused closures"
        found.append(f"Of {known} the {kept:,} with the largest xi are drawn.")
    return found
