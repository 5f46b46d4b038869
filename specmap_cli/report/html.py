"""HTML pages that need no other file: templates filled, and figures as a person reads them."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from specmap_cli import __version__
from specmap_cli.core.text import encodable, legible
from specmap_cli.core.text import seconds as stamp_seconds

PACKAGE = "specmap_cli.report"
_EPOCH_S = 1e8  # stamps below this count from the start of a robot or of a simulation
_MINUTE, _HOUR = 60, 3600

# The families of features by the beginning of their columns; the first that fits counts.
_FAMILIES = (
    ("difference_", "how much neighbouring beams differ"),
    ("gaps_over_", "leaps between neighbouring beams"),
    ("range_quantile_", "quantile of the ranges"),
    ("range_extent", "longest against shortest range"),
    ("range_", "spread of the ranges"),
    ("area_convexity", "how convex the outline is"),
    ("perimeter_convexity", "how convex the outline is"),
    ("area", "area seen"),
    ("perimeter", "length of the outline"),
    ("circularity", "how round the outline is"),
    ("compactness", "how round the outline is"),
    ("hu_", "shape of the area, Hu's moments"),
    ("no_return_share", "beams without a return"),
    ("aspect_ratio", "long or square"),
    ("centroid_distance", "distance of the walls from their middle"),
    ("second_derivative", "how bumpy the outline is"),
    ("fine_distance_", "pairs of points this far apart"),
    ("distance_", "pairs of points this far apart"),
    ("pieces", "smooth pieces of the outline"),
    ("piece_", "smooth pieces of the outline"),
    ("share_below_", "beams shorter than this"),
    ("clipped_", "ranges cut at this length"),
    ("pairs_", "pairs of wall points by distance and angle"),
    ("boundary_", "length of the walls seen"),
    ("ring_", "walls at this distance"),
    ("harmonic_", "rhythm of the ranges round the robot"),
)


def html_page(
    package: str,
    template: str,
    context: Mapping[str, Any],
    styles: Iterable[str],
    scripts: Iterable[str] = (),
    filters: Mapping[str, Callable[..., Any]] | None = None,
) -> str:
    """The text of a page of `package`; whatever it shows is escaped.

    Templates, styles and scripts are looked for in the folders of `package`, then in those of the
    report. The page runs no other script than these: it has their hash. Templates may use the
    filters of this module, and more `filters`.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(name, "templates") for name in (package, PACKAGE)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"sort_keys": True, "separators": (",", ":")}
    usual = (clock, lasting, moment, stamp, percent, figure, letter, feature_words)
    environment.filters.update({each.__name__: each for each in usual}, **(filters or {}))
    script = _joined(package, "scripts", scripts)
    digest = hashlib.sha256(script.encode("utf-8")).digest()
    parts = {
        "script": script,
        "script_hash": f"sha256-{base64.b64encode(digest).decode('ascii')}",
        "style": _joined(package, "styles", styles),
        "version": __version__,
    }
    return encodable(environment.get_template(template).render({**context, **parts}))


def _joined(package: str, folder: str, names: Iterable[str]) -> str:
    """Files of a folder of `package`, else of the report, one after the other."""
    texts = []
    for name in names:
        own = resources.files(package) / folder / name
        file = own if own.is_file() else resources.files(PACKAGE) / folder / name
        texts.append(file.read_text(encoding="utf-8"))
    return "\n".join(texts)


def feature_words(feature: str) -> str:
    """What a feature is about; empty for one of another package."""
    return next((words for start, words in _FAMILIES if feature.startswith(start)), "")


def clock(seconds: float) -> str:
    """`7:05`, or `1:02:03`."""
    whole = round(seconds)
    hours, rest = divmod(whole, _HOUR)
    minutes, left = divmod(rest, _MINUTE)
    return f"{hours}:{minutes:02d}:{left:02d}" if hours else f"{minutes}:{left:02d}"


def lasting(seconds: float) -> str:
    """`42 s`, `7 min`, `1 h 5 min`."""
    if seconds < 2 * _MINUTE:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / _MINUTE), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def moment(stamp_s: float | None) -> str:
    """A stamp as date and time in UTC; as seconds where it counts from no known day."""
    if stamp_s is None:
        return ""
    if stamp_s < _EPOCH_S:
        return f"{stamp_s:.1f} s"
    return datetime.fromtimestamp(stamp_s, tz=UTC).strftime("%Y-%m-%d %H:%M:%S UTC")


def stamp(stamp_ns: int) -> str:
    """A stamp in nanoseconds as `moment` says it."""
    return moment(stamp_seconds(stamp_ns))


def letter(number: int) -> str:
    """`A` for 1, `Z` for 26, `AA` for 27: the sign of a finding, where submaps have numbers."""
    rest, last = divmod(number - 1, 26)
    return (letter(rest) if rest else "") + chr(ord("A") + last)


def percent(share: float | None) -> str:
    """`93 %`."""
    return "" if share is None else f"{100.0 * share:.0f} %"


def figure(value: float | None, places: int = 2) -> str:
    """A number with some decimals; a dash where there is none. The minus is a real one."""
    return "–" if value is None else f"{value:,.{places}f}".replace("-", "−")


def shown(text: str) -> str:
    """A person's text on one line: no control characters, no endless blanks."""
    return legible(re.sub(r"\s+", " ", text).strip())
