"""Hypothesis strategies for the records of the shared floor."""

import math
import os

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st

from specmap_cli.core.geometry import FloatArray, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.gridmap import FREE, OCCUPIED, UNKNOWN, GridMap

# Cases of a test of random inputs: few in the gate, `make fuzz` asks for many (SPECMAP_CASES=many).
MANY = os.environ.get("SPECMAP_CASES") == "many"
FEW_CASES, MANY_CASES = 25, 400


def few(cases: int) -> settings:
    """Another number of cases in the gate: fewer where one is slow, more where most say nothing."""
    return settings(max_examples=MANY_CASES if MANY else cases)


lengths = st.floats(-50.0, 50.0, allow_nan=False).map(lambda v: round(v, 6))
angles = st.floats(-math.pi, math.pi, exclude_max=True, allow_nan=False)
poses = st.builds(Pose2, lengths, lengths, angles)
seeds = st.integers(0, 2**32 - 1)


@st.composite
def pose_arrays(draw: st.DrawFn, size: int | None = None) -> FloatArray:
    """Poses (n, 3) of the plane."""
    count = size if size is not None else draw(st.integers(1, 6))
    return np.array(draw(st.lists(poses, min_size=count, max_size=count)), dtype=np.float64)


@st.composite
def planar_scans(draw: st.DrawFn, beams: int = 72, reach: float = 6.0) -> PlanarScan:
    """Full-circle scans with returns, beams without one, and invalid readings."""
    rng = np.random.default_rng(draw(seeds))
    ranges = rng.uniform(0.2, reach, beams)
    kinds = rng.random(beams)
    ranges[kinds < 0.2] = np.inf
    ranges[kinds > 0.9] = np.nan
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    return PlanarScan(draw(st.integers(0, 10**12)), bearings, ranges, 20.0, True)


@st.composite
def grid_maps(draw: st.DrawFn, largest: int = 24) -> GridMap:
    """Small trinary grids of any content."""
    rng = np.random.default_rng(draw(seeds))
    height, width = draw(st.integers(2, largest)), draw(st.integers(2, largest))
    cells = rng.choice([FREE, OCCUPIED, UNKNOWN], size=(height, width), p=[0.6, 0.2, 0.2])
    origin = (draw(lengths), draw(lengths))
    return GridMap(cells.astype(np.uint8), draw(st.sampled_from([0.05, 0.1, 0.25])), origin)
