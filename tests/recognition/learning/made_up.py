"""Made-up submaps: samples that differ in a few columns."""

import numpy as np

from specmap_cli.core.config import load_config
from specmap_cli.core.geometry import FloatArray
from specmap_cli.core.settings import Config
from specmap_cli.recognition.features.sets import feature_names

SMALL = load_config(overrides={"recognition": {"rounds": 25, "feature_set": "pairs"}})
PAPER = load_config(
    overrides={"recognition": {"rounds": 10, "feature_set": "table1", "booster": "stumps"}}
)


def samples_of(config: Config, n: int = 90, seed: int = 1) -> dict[int, FloatArray]:
    """Samples of the classes 0, 2 and 4 in the columns of the settings' feature set."""
    rng = np.random.default_rng(seed)
    width = len(feature_names(config.recognition.feature_set))
    made = {}
    for k in range(3):
        X = rng.uniform(0.0, 0.2, (n, width))
        X[:, 3 * k : 3 * k + 3] += 0.3
        made[2 * k] = X
    return made
