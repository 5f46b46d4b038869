"""Where the searches of a registration look, and how far a place may be from the guess."""

from __future__ import annotations

import math

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window
from specmap_cli.registration.prospect import SEARCH_RAD, Prospect
from specmap_cli.registration.scene import Bounds

SEARCH_M = 0.25  # half width of the search: odometry's error
_BLIND_SEARCH_M = 0.3  # half width of the search without odometry
_BLIND_SEARCH_RAD = 0.5  # half angle of the search without odometry
_WIDE_SEARCH_M = 1.0  # half width of the wide search: a hole in the log
_WIDE_SEARCH_RAD = 1.6  # half angle of the wide search

# Steps of the two searches: about a cell of the score field, no finer, and a rough one.
_STEP_M, _WIDE_STEP_M = 0.05, 0.1
# Score that a place loses for each m^2 and rad^2 from the guess: of places that fit alike the
# nearest is taken. The wide search is for holes in the log, where the guess says little.
_PER_M2, _PER_RAD2 = 1.0, 0.4
_WIDE_PER_M2, _WIDE_PER_RAD2 = 0.15, 0.05


def near_window(*, measured: bool) -> Window:
    """Where odometry's errors, or the changes of an unmeasured motion, can have led."""
    distance_m = SEARCH_M if measured else _BLIND_SEARCH_M
    angle_rad = SEARCH_RAD if measured else _BLIND_SEARCH_RAD
    return Window(
        distance_m=distance_m,
        angle_rad=angle_rad,
        step_m=_STEP_M,
        penalty_per_m2=_PER_M2,
        penalty_per_rad2=_PER_RAD2,
    )


def wide_window(prospect: Prospect, config: RegistrationConfig, *, free: bool) -> Window:
    """Where the robot can have come in a hole of the log, or by wheels that slipped.

    Unless it is `free`, odometry is trusted: it does not err by a wide turn, but wheels may have
    turned in vain.
    """
    slipped_m = _WIDE_SEARCH_M + prospect.expected.motion.distance
    return Window(
        distance_m=_WIDE_SEARCH_M if free else min(config.max_shift_m, slipped_m),
        angle_rad=_WIDE_SEARCH_RAD if free else SEARCH_RAD,
        step_m=_WIDE_STEP_M,
        penalty_per_m2=_WIDE_PER_M2,
        penalty_per_rad2=_WIDE_PER_RAD2,
    )


def wide_bounds(guess: FloatArray, config: RegistrationConfig) -> Bounds:
    """As far as the wide search looks, if that is farther than other results may be."""
    corner_m = math.hypot(_WIDE_SEARCH_M, _WIDE_SEARCH_M)
    return Bounds(
        guess,
        shift_m=max(config.max_shift_m, corner_m + _WIDE_STEP_M),
        shift_rad=max(config.max_shift_rad, _WIDE_SEARCH_RAD + SEARCH_RAD),
        tilt_rad=config.max_tilt_rad,
    )
