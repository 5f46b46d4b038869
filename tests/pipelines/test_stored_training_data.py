"""Training data in a map directory: kept, used by what comes after, let go where it errs."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from specmap_cli import build_map, read_map
from specmap_cli.core.records import IntArray, Labels
from specmap_cli.core.settings import Config
from specmap_cli.maps.store import Map
from specmap_cli.pipelines import learning
from specmap_cli.pipelines.localizer import classifiers_of
from specmap_cli.recognition.learning.sampling import Samples, TrainingData
from tests.flats import QUICK
from tests.maps.conftest import edit


def samples(*keyframes: int) -> Samples:
    numbers = np.array(keyframes, dtype=np.intp)
    return Samples(np.ones((len(numbers), 2)), numbers)


def test_features_survive_the_file_in_half_precision() -> None:
    large = Samples(np.array([[1.0 / 3.0, 1e9], [-1e9, 0.0]]), np.array([2, 5], dtype=np.intp))
    arrays = learning.arrays_of(TrainingData(large, samples(), samples(), samples()))
    assert arrays["raw"].T.tolist() == [[0.333251953125, 65504.0], [-65504.0, 0.0]]
    assert arrays["raw_keyframes"].tolist() == [2, 5]
    assert arrays["raw"].dtype == np.float16


def changed(config: Config, section: str, **settings: Any) -> Config:
    values = config.model_dump()
    values[section] |= settings
    return Config.model_validate(values)


def learned_from(stored: Map, config: Config) -> int:
    """How many scans of a map are learned from with these settings without being made anew."""
    return len(learning.training_data_of_stored(stored, config).raw.keyframes)


def test_what_was_learned_from_is_kept_for_these_settings(flat_map: Map, tmp_path: Path) -> None:
    config = flat_map.config
    data = learning.training_data_of_stored(flat_map, config)
    for own in data.kinds:
        assert len(own.features) == len(own.keyframes) > 0
    assert len(np.unique(data.raw.keyframes)) == len(data.raw.keyframes)
    assert learned_from(flat_map, changed(config, "recognition", feature_set="table1")) == 0
    assert learned_from(flat_map, changed(config, "localization", false_unknown=0.1)) == 0
    found = learning.training_data_of_stored(flat_map, changed(config, "grid", footprint_m=0.3))
    assert len(found.cast.keyframes) == 0 < len(found.along.keyframes), "cast in other grids"
    without = shutil.copytree(flat_map.path, tmp_path / "without")
    (without / "features.npz").unlink()
    assert learned_from(read_map(without), config) == 0


@pytest.mark.parametrize("without", [{"virtual": False}, {"augmentation": 0}])
def test_a_map_without_some_kind_of_scans_keeps_the_others(
    tiny_log: Path, tmp_path: Path, without: dict[str, Any]
) -> None:
    build_map(tiny_log, tmp_path / "map", changed(QUICK, "localization", **without))
    stored = read_map(tmp_path / "map")
    found = learning.training_data_of_stored(stored, stored.config)
    assert len(found.raw.keyframes) > 0 == len(found.cast.keyframes)


@pytest.mark.parametrize("footprint_m", [None, 7], ids=["known settings", "unknown settings"])
def test_versions_learn_anew(footprint_m: float | None, flat_map: Map, tmp_path: Path) -> None:
    own = Path(shutil.copytree(flat_map.path, tmp_path / "own"))
    more = {} if footprint_m is None else {"config__grid__footprint_m": footprint_m}
    edit(own / "run.json", versions__specmap="0.0.1", **more)
    other = read_map(own)
    assert learned_from(other, flat_map.config) == 0
    assert learning.comparable(classifiers_of(other), other, flat_map.config) is None


def test_classifiers_of_other_settings_are_no_test(flat_map: Map) -> None:
    classifiers = classifiers_of(flat_map)
    assert learning.comparable(classifiers, flat_map, flat_map.config) is classifiers
    more = changed(flat_map.config, "recognition", rounds=1 + flat_map.config.recognition.rounds)
    assert learning.comparable(classifiers, flat_map, more) is None


def labels(poses: list[tuple[float, float, float]], submaps: list[int]) -> Labels:
    stamps: IntArray = np.arange(len(submaps), dtype=np.int64)
    return Labels(stamps_ns=stamps, poses=np.array(poses), submaps=np.array(submaps))


ALL = [*range(6)]
ROW = [(float(x), 0.0, 0.0) for x in ALL]
BEFORE = labels(ROW, [0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(
    ("left", "now", "cast"),
    [
        (ALL, labels([*ROW, (7.0, 0.0, 0.0)], [0, 0, 0, 1, 1, 1, 1]), [0, 2]),
        ([0, 2, 3, 4, 5], labels([ROW[k] for k in (0, 2, 3, 4, 5)], [0, 0, 1, 1, 1]), [2, 4]),
        (ALL, labels([(y, x, 0.0) for x, y, _ in ROW], BEFORE.submaps.tolist()), [0, 2, 3, 5]),
        (ALL, labels([*ROW[:5], (5.0, 0.5, 0.0)], BEFORE.submaps.tolist()), [0, 2]),
        (ALL, labels(ROW, [0] * 6), []),
    ],
    ids=["visited again", "a keyframe is gone", "moved as a whole", "bent", "two are one now"],
)
def test_scans_cast_hold_while_submaps_do(left: list[int], now: Labels, cast: list[int]) -> None:
    data = TrainingData(samples(0, 5), samples(), samples(1), samples(0, 2, 3, 5))
    found = learning.valid_training_data(data, BEFORE, now, np.array(left), 0.05)
    assert found.cast.keyframes.tolist() == cast


def test_training_data_of_a_map_behind_another_are_numbered_behind_it() -> None:
    data = TrainingData(samples(0, 5), samples(2), samples(1), samples(0, 5))
    now = labels([*ROW, *ROW], [7, 7, 7, 0, 0, 0, 0, 0, 0, 1, 1, 1])
    found = learning.valid_training_data(data, BEFORE, now, np.arange(6), 0.05, first=6)
    assert found.raw.keyframes.tolist() == [6, 11]
    assert found.along.keyframes.tolist() == [7]
    assert found.beside.keyframes.tolist() == [8]
    assert found.cast.keyframes.tolist() == [11]  # the first submap has keyframes of both maps
