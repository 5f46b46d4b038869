"""features.npz: written and read back, and refused in one line when it is damaged or too large."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.maps.features_file import KEYFRAMES_OF, KINDS, read_features, write_features

LIMITS = LimitsConfig()
Arrays = dict[str, NDArray[Any]]


def arrays() -> Arrays:
    """Three samples of each kind, of two, three and four features."""
    made: Arrays = {}
    for count, kind in enumerate(KINDS, start=2):
        made[kind] = np.arange(3 * count, dtype=np.float16).reshape(count, 3)
        made[kind + KEYFRAMES_OF] = np.array([0, 4, 9], dtype=np.int32)
    return made


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    write_features(tmp_path / "features.npz", arrays())
    found = read_features(tmp_path / "features.npz", 10, LIMITS)
    assert found.keys() == arrays().keys()
    for name, values in arrays().items():
        assert np.array_equal(found[name], values)
    with np.load(tmp_path / "features.npz", allow_pickle=False) as known:
        assert np.array_equal(known["raw"], arrays()["raw"])


def test_a_file_of_an_older_map_has_none_from_beside(tmp_path: Path) -> None:
    older = {name: values for name, values in arrays().items() if not name.startswith("beside")}
    write_features(tmp_path / "features.npz", older)
    found = read_features(tmp_path / "features.npz", 10, LIMITS)
    assert found.keys() == arrays().keys()
    assert found["beside"].size == len(found["beside" + KEYFRAMES_OF]) == 0
    assert np.array_equal(found["raw"], arrays()["raw"])


def test_the_same_features_are_the_same_bytes(tmp_path: Path) -> None:
    for name in ("one", "other"):
        write_features(tmp_path / name, arrays())
    assert (tmp_path / "one").read_bytes() == (tmp_path / "other").read_bytes()


def of_strangers(made: Arrays) -> None:
    made["along" + KEYFRAMES_OF] = np.array([0, 4, 10], dtype=np.int32)


def negative(made: Arrays) -> None:
    made["along" + KEYFRAMES_OF] = np.array([-1, 4, 9], dtype=np.int32)


def infinite(made: Arrays) -> None:
    made["cast"][1, 1] = np.inf


def of_another_kind(made: Arrays) -> None:
    made["raw"] = made["raw"].astype(np.float32)


def of_another_count(made: Arrays) -> None:
    made["raw"] = made["raw"][:, :2]


def without_one(made: Arrays) -> None:
    del made["raw"]


@pytest.mark.parametrize(
    "damage", [of_strangers, negative, infinite, of_another_kind, of_another_count, without_one]
)
def test_arrays_that_make_no_sense_are_refused(
    tmp_path: Path, damage: Callable[[Arrays], None]
) -> None:
    made = arrays()
    damage(made)
    write_features(tmp_path / "features.npz", made)
    with pytest.raises(MapError, match=r"features.npz: .*delete it") as caught:
        read_features(tmp_path / "features.npz", 10, LIMITS)
    assert "\n" not in str(caught.value)


def test_objects_are_never_loaded(tmp_path: Path) -> None:
    path = tmp_path / "features.npz"
    write_features(path, {name: values for name, values in arrays().items() if name != "raw"})
    data = io.BytesIO()
    np.lib.format.write_array(data, np.array([{}], dtype=object), (1, 0), allow_pickle=True)
    with zipfile.ZipFile(path, "a") as packed:
        packed.writestr("raw.npy", data.getvalue())
    with pytest.raises(MapError, match="no zip file of arrays"):
        read_features(path, 10, LIMITS)


@pytest.mark.parametrize("keep", [0, 10, 400])
def test_a_file_cut_short_is_refused(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "features.npz"
    write_features(path, arrays())
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(MapError, match="no zip file of arrays"):
        read_features(path, 10, LIMITS)


def test_a_small_file_that_swells_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path, made = tmp_path / "features.npz", arrays()
    made["raw"] = np.zeros((1000, 3), dtype=np.float16)
    write_features(path, made)
    assert path.stat().st_size < 3000
    with pytest.raises(MapError, match=r"unpacked larger than limits\.text_max_mb"):
        read_features(path, 10, LimitsConfig(text_max_mb=0.005))


def encrypted(path: Path) -> None:
    data = bytearray(path.read_bytes())
    for start in (b"PK\x03\x04", b"PK\x01\x02"):
        data[data.index(start) + (6 if start[2] == 3 else 8)] |= 1
    path.write_bytes(data)


def of_header(path: Path, header: bytes) -> None:
    with zipfile.ZipFile(path) as packed:
        members = {name: packed.read(name) for name in packed.namelist()}
    members["raw.npy"] = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(path, "w") as packed:
        for name, data in members.items():
            packed.writestr(name, data)


@pytest.mark.parametrize(
    "header",
    [
        b"(" * 5000,
        b"(",
        b"{[1]: 2}",
        b"{1: 2, 'descr': 3}",
        b"  x\n y",
        b"{'descr': (), 'fortran_order': False, 'shape': (2, 0), }",
        b"{'descr': '<f2', 'fortran_order': False, 'shape': (True, 0), }",
    ],
)
def test_headers_that_numpy_fails_on_are_refused(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "features.npz"
    write_features(path, arrays())
    of_header(path, header)
    with pytest.raises(MapError, match=r"features.npz: is no zip file of arrays: delete it"):
        read_features(path, 10, LIMITS)


def packed_otherwise(path: Path) -> None:
    with zipfile.ZipFile(path) as packed:
        members = {name: packed.read(name) for name in packed.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as packed:
        for name, data in members.items():
            packed.writestr(name, data)


@pytest.mark.parametrize("damage", [encrypted, packed_otherwise])
def test_what_no_map_holds_is_refused(tmp_path: Path, damage: Callable[[Path], None]) -> None:
    path = tmp_path / "features.npz"
    write_features(path, arrays())
    damage(path)
    with pytest.raises(MapError, match=r"features.npz: is .*delete it"):
        read_features(path, 10, LIMITS)
