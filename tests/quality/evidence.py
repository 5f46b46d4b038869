"""What a verdict is made of, for a drive in which nothing is wrong but what is asked for."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from specmap_cli.core.findings import Quality
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.records import Trajectory
from specmap_cli.layout.result import Layout
from specmap_cli.quality.evidence import Evidence
from specmap_cli.quality.findings import of_layout, of_recording


def evidence_of(
    poses: FloatArray,
    every_ns: int = 10**9,
    odometry: FloatArray | None = None,
    lost: Sequence[int] = (),
    layout: dict[str, Any] | None = None,
    **told: Any,
) -> Evidence:
    """The evidence of poses, each of them a keyframe."""
    stamps, marks = np.arange(len(poses)) * every_ns, np.zeros(len(poses), dtype=np.bool_)
    marks[list(lost)] = True
    fields: dict[str, Any] = {"breaks": (), "beyond": 0, "warnings": (), **told}
    return Evidence(
        trajectory=Trajectory(stamps, poses, odometry=odometry, lost=marks),
        keyframes_ns=stamps,
        layout=Layout(poses=poses, **(layout or {})),
        **fields,
    )


def judged(evidence: Evidence) -> Quality:
    """The verdict on a recording and its layout."""
    return Quality.of([*of_recording(evidence), *of_layout(evidence)])
