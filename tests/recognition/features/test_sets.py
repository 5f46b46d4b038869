"""Feature sets: one table of them, what the settings may name, and sets of other packages."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from specmap_cli.core.config import load_config
from specmap_cli.core.errors import UsageError
from specmap_cli.core.geometry import IDENTITY, Pose2
from specmap_cli.core.records import PlanarScan
from specmap_cli.grids.keyframes import KeyframeStore
from specmap_cli.recognition.features.group import BatchGroup
from specmap_cli.recognition.features.returns import ReturnsBatch
from specmap_cli.recognition.features.sets import (
    BUILT_IN,
    KeyframeFeatures,
    check_feature_sets,
    feature_names,
    feature_sets,
    histogram_columns,
    scans_features,
)
from tests.recognition.posed import posed
from tests.recognition.watching import watched


def scan(range_m: float = 3.0, beams: int = 180) -> PlanarScan:
    bearings = np.linspace(-np.pi, np.pi, beams, endpoint=False)
    ranges = range_m + 0.2 * np.cos(3.0 * bearings)
    return PlanarScan(0, bearings, ranges, range_max=20.0, full_circle=True)


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_set_holds_what_its_groups_give_and_histograms_are_shares_of_one(name: str) -> None:
    columns, features = feature_names(name), scans_features([scan()], name)[0]
    assert len(set(columns)) == len(columns)
    assert features.shape == (len(columns),)
    assert scans_features([], name).shape == (0, len(columns))
    values = dict(zip(columns, features.tolist(), strict=True))
    for group in BUILT_IN[name]:
        assert isinstance(group, BatchGroup)
        given = group.compute(ReturnsBatch.of([scan()]))[0].astype(np.float32).tolist()
        assert [values[column] for column in group.columns] == given
        shares = [values[column] for column in group.histogram]
        assert min(shares, default=0.0) >= 0.0
        assert not shares or sum(shares) == pytest.approx(1.0)
    marked = [column for group in BUILT_IN[name] for column in group.histogram]
    assert marked
    assert [columns[k] for k in histogram_columns(name)] == marked


@pytest.mark.parametrize("name", BUILT_IN)
def test_a_scan_has_the_same_features_whatever_comes_with_it(name: str) -> None:
    half = PlanarScan(0, np.linspace(-1.5, 1.5, 91), np.linspace(1.0, 6.0, 91), 20.0, False)
    nothing = PlanarScan(0, np.zeros(0), np.zeros(0), 20.0, full_circle=False)
    lost = replace(half, ranges=np.full(91, np.inf))
    scans = [scan(), lost, *(scan(2.0 + 0.1 * k, 60 + k) for k in range(40)), nothing, half]
    together = scans_features(iter(scans), name)
    assert together.tolist() == [scans_features([each], name)[0].tolist() for each in scans]


def test_the_paper_s_set_is_part_of_all_others() -> None:
    paper = feature_names("table1")
    for name in BUILT_IN:
        assert feature_names(name)[: len(paper)] == paper


@pytest.mark.parametrize("section", ["recognition", "localization"])
def test_a_setting_that_names_no_set_is_told_before_the_work(section: str) -> None:
    config = load_config(overrides={section: {"feature_set": "tabel1"}})
    with pytest.raises(UsageError) as error:
        check_feature_sets(config)
    assert str(error.value) == (
        f"{section}.feature_set: unknown feature set 'tabel1': choose from full, pairs, places, "
        "shape, table1, or install the package that offers it"
    )


@pytest.mark.parametrize("use", [feature_names, histogram_columns, partial(scans_features, [])])
def test_an_unknown_set_is_told_wherever_it_is_used(use: Callable[[str], object]) -> None:
    with pytest.raises(UsageError, match="feature_set: unknown feature set 'mine'"):
        use("mine")


def test_a_package_adds_a_set(install: Callable[..., None]) -> None:
    install("mine")
    assert list(feature_sets()) == [*BUILT_IN, "mine"]
    assert feature_names("mine") == ("reach", "returns", "rings_near", "rings_middle", "rings_far")
    assert histogram_columns("mine") == [2, 3, 4]
    assert scans_features([scan()], "mine")[0] == pytest.approx([3.2, 180.0, 0.0, 1.0, 0.0])
    check_feature_sets(load_config(overrides={"recognition": {"feature_set": "mine"}}))


def test_the_name_of_a_set_cannot_be_taken(install: Callable[..., None]) -> None:
    install("full")
    with pytest.raises(UsageError, match=r"stranger.*'full'.*exists already"):
        feature_sets()


HEAD = """
import numpy as np
from specmap_cli.recognition.features.group import BatchGroup, FeatureGroup
"""


@pytest.mark.parametrize(
    ("groups", "why"),
    [
        ("7", "it is no tuple of FeatureGroup"),
        ("()", "it is no tuple of FeatureGroup"),
        ("(len,)", "it is no tuple of FeatureGroup"),
        (
            "(FeatureGroup(len, ('a', 'b')), FeatureGroup(len, ('b',)))",
            "two of its columns have one name",
        ),
        ("[FeatureGroup(len, ())]", "a group has no columns, or histograms"),
        ("[FeatureGroup(len, ('a',), ('b',))]", "a group has no columns, or"),
    ],
)
def test_what_is_no_set_is_refused(groups: str, why: str, install: Callable[..., None]) -> None:
    install("mine", f"{HEAD}GROUPS = {groups}")
    with pytest.raises(UsageError) as error:
        feature_names("full")
    assert str(error.value).startswith(f"feature set 'mine': {why}")
    assert str(error.value).endswith("mend or remove the package that offers it")
    assert "\n" not in str(error.value)


ONE = "FeatureGroup(lambda returns: {}, ('a', 'b'))"
MANY = "BatchGroup(lambda batch: np.zeros({}), ('a',))"


@pytest.mark.parametrize(
    ("group", "given", "why"),
    [
        (ONE, "[1.0]", "the group of 'a' gives 1 values for its 2 columns"),
        (ONE, "[1.0, 2.0, 3.0]", "the group of 'a' gives 3 values for its 2 columns"),
        (ONE, "[1.0, float('nan')]", "'b' is not finite for a scan"),
        (ONE, "[float('-inf'), 1.0]", "'a' is not finite for a scan"),
        (MANY, "(len(batch), 2)", "'a' gives 2 values for its 1 columns"),
        (MANY, "(len(batch), 1, 3)", "'a' gives 1 by 3 values for its 1 columns"),
        (MANY, "(len(batch) + 1, 1)", "'a' gives 2 by 1 values for its 1 columns"),
    ],
)
def test_a_function_that_breaks_its_word_is_told(
    group: str, given: str, why: str, install: Callable[..., None]
) -> None:
    install("mine", f"{HEAD}GROUPS = ({group.format(given)},)")
    with pytest.raises(UsageError, match=why):
        scans_features([scan()], "mine")


def test_a_package_may_compute_many_scans_at_once(install: Callable[..., None]) -> None:
    group = "BatchGroup(lambda batch: batch.counts[:, None] * 1.0, ('returns',))"
    install("mine", f"{HEAD}GROUPS = ({group},)")
    assert scans_features([scan(beams=90), scan(beams=180)], "mine").tolist() == [[90.0], [180.0]]


@pytest.mark.parametrize(("most", "again"), [(16, []), (3, []), (2, [2]), (0, [0, 1, 2])])
def test_keyframes_have_their_features_computed_once_while_there_is_room(
    most: int, again: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    read = watched(monkeypatch, KeyframeStore, "scan")
    with KeyframeStore() as store:
        for k in range(4):
            store.append(posed(scan(2.0 + k), Pose2(0.1 * k, 0.0, 0.0), k))
        features = KeyframeFeatures(store, "table1", most)
        first = features.of([0, 1, 0, 2])
        assert [number for _, number in read] == [0, 1, 2]
        second = features.of([2, 1, 0])
        assert sorted(number for _, number in read[3:]) == again
        assert features.of([]).shape == (0, len(feature_names("table1")))
        expected = scans_features([store.scan(k) for k in range(3)], "table1")
    assert first.tolist() == expected[[0, 1, 0, 2]].tolist()
    assert second.tolist() == expected[::-1].tolist()


def test_features_that_are_known_are_known_in_a_store_of_more_keyframes() -> None:
    with KeyframeStore() as own, KeyframeStore() as joint:
        for k, store in enumerate((joint, joint, own, own)):
            store.append(posed(scan(2.0 + k), IDENTITY, k))
        features = KeyframeFeatures(own, "table1")
        features.of([1])
        joint.extend(own)
        moved = features.among(joint, 2)
        assert moved.known(range(4)) == [3]
        found = moved.of([0, 3])
        expected = scans_features([joint.scan(0), joint.scan(3)], "table1")
    assert found.tolist() == expected.tolist()


def test_values_beyond_single_precision_are_cut() -> None:
    """Moments of four odd readings: no reason to end a run."""
    ranges = np.array([0.0, 3.0, 1.1920928955078146e-07, 1.0])
    scan = PlanarScan(0, np.linspace(-1.0, 1.0, 4), ranges, range_max=20.0, full_circle=False)
    features = scans_features([scan], "full")[0]
    assert np.isfinite(features).all()
    assert (features == features.astype(np.float32)).all()
