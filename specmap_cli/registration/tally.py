"""What the front end counts, and what it says when something went beyond a limit."""

from __future__ import annotations

from collections.abc import Mapping

from specmap_cli.core.settings import RegistrationConfig
from specmap_cli.core.text import counted

COUNTS: Mapping[str, str] = {
    "registered": "sweeps with a trusted pose",
    "lost": "sweeps that kept the guess",
    "searched": "sweeps that called for the correlative search",
    "wide_searched": "sweeps that called for the wide search, too",
    "breaks": "runs of lost sweeps that ended a map",
    "odometry_jumps": "odometry increments too large to be a motion",
    "shortened_motions": "sweeps whose guess or de-skewing was held to what may be carried on",
    "few_points": "sweeps with fewer than min_points walls: lost, or placed by odometry alone",
    "refused_alignments": "alignments that moved or tilted farther than allowed",
    "walls_left_out": "sweeps scored on a field too small for all walls of the local map",
}


# Of a limit that something went beyond: what is counted, and what to say of so many.
_SENTENCES: Mapping[str, tuple[str, str]] = {
    "odometry_jumps": (
        "jump",
        "registration met {hits} of odometry beyond registration.odometry_jump_m and "
        "odometry_jump_mps: the motion before was carried on instead",
    ),
    "shortened_motions": (
        "scan",
        "registration carried the motion before on to {hits} only in part: raise "
        "registration.carried_forward_m, carried_sideways_m and carried_rad for a fast robot",
    ),
    "few_points": (
        "scan",
        "registration met {hits} with fewer than {limits.min_points} wall points "
        "(registration.min_points): they are placed by odometry that is trusted, or lost",
    ),
    "refused_alignments": (
        "alignment",
        "registration refused {hits} that ended farther from the guess, or tilted more, than "
        "registration.max_shift_m, max_shift_rad and max_tilt_rad allow",
    ),
}


def warnings_of(counts: Mapping[str, int], config: RegistrationConfig) -> list[str]:
    """A sentence for each limit that something went beyond, with the settings that set it."""
    return [
        sentence.format(hits=counted(counts[name], noun), limits=config)
        for name, (noun, sentence) in _SENTENCES.items()
        if counts[name]
    ]
