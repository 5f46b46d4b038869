"""Where the searches of a registration look, and how far a place may be from the guess."""

from __future__ import annotations

import math

from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.grids.matching import Window
from specmap_cli.registration.prospect import Prospect
from specmap_cli.registration.scene import Bounds

# Steps of the two searches: about a cell of the score field, no finer, and a rough one.
_STEP_M, _WIDE_STEP_M = 0.05, 0.1
# Score that a place loses for each m^2 and rad^2 from the guess: of places that fit alike the
# nearest is taken. The wide search is for holes in the log, where the guess says little.
_PER_M2, _PER_RAD2 = 1.0, 0.4
_WIDE_PER_M2, _WIDE_PER_RAD2 = 0.15, 0.05


def near_window(config: RegistrationConfig, *, measured: bool) -> Window:
    """Where odometry's errors, or the changes of an unmeasured motion, can have led."""
    distance_m = config.search_m if measured else config.blind_search_m
    angle_rad = config.search_rad if measured else config.blind_search_rad
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
    slipped_m = config.wide_search_m + prospect.expected.motion.distance
    return Window(
        distance_m=config.wide_search_m if free else min(config.max_shift_m, slipped_m),
        angle_rad=config.wide_search_rad if free else config.search_rad,
        step_m=_WIDE_STEP_M,
        penalty_per_m2=_WIDE_PER_M2,
        penalty_per_rad2=_WIDE_PER_RAD2,
    )


def wide_bounds(guess: FloatArray, config: RegistrationConfig) -> Bounds:
    """As far as the wide search looks, if that is farther than other results may be."""
    corner_m = math.hypot(config.wide_search_m, config.wide_search_m)
    return Bounds(
        guess,
        shift_m=max(config.max_shift_m, corner_m + _WIDE_STEP_M),
        shift_rad=max(config.max_shift_rad, config.wide_search_rad + config.search_rad),
        tilt_rad=config.max_tilt_rad,
    )
