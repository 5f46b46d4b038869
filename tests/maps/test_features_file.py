"""features.npz: written and read back, and refused in one line when it is damaged or too large."""

import io
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from specmap_cli.core.errors import MapError
from specmap_cli.core.settings import LimitsConfig
from specmap_cli.maps.features_file import KEYFRAMES_OF, KINDS, read_features, write_features

LIMITS = LimitsConfig()
Arrays = dict[str, NDArray[Any]]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_features(tmp_path / "features.npz", arrays())
    return tmp_path / "features.npz"


def arrays() -> Arrays:
    """Three samples of each kind, of two, three and four features."""
    made: Arrays = {}
    for count, kind in enumerate(KINDS, start=2):
        made[kind] = np.arange(3 * count, dtype=np.float16).reshape(count, 3)
        made[kind + KEYFRAMES_OF] = np.array([0, 4, 9], dtype=np.int32)
    return made


def test_what_is_written_is_read_back_and_the_same_bytes_every_time(path: Path) -> None:
    found = read_features(path, 10, LIMITS)
    assert found.keys() == arrays().keys()
    for name, values in arrays().items():
        assert np.array_equal(found[name], values)
    with np.load(path, allow_pickle=False) as known:
        assert np.array_equal(known["raw"], arrays()["raw"])
    write_features(path.with_name("other"), arrays())
    assert path.read_bytes() == path.with_name("other").read_bytes()


def test_a_file_of_an_older_map_has_none_from_beside(tmp_path: Path) -> None:
    older = {name: values for name, values in arrays().items() if not name.startswith("beside")}
    write_features(tmp_path / "features.npz", older)
    found = read_features(tmp_path / "features.npz", 10, LIMITS)
    assert found.keys() == arrays().keys()
    assert found["beside"].size == len(found["beside" + KEYFRAMES_OF]) == 0
    assert np.array_equal(found["raw"], arrays()["raw"])


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("along" + KEYFRAMES_OF, np.array([0, 4, 10], dtype=np.int32)),  # there are ten
        ("along" + KEYFRAMES_OF, np.array([-1, 4, 9], dtype=np.int32)),
        ("cast", np.where(arrays()["cast"] == 4.0, np.inf, arrays()["cast"]).astype(np.float16)),
        ("raw", arrays()["raw"].astype(np.float32)),
        ("raw", arrays()["raw"][:, :2]),
        ("raw", None),
    ],
)
def test_absurd_arrays_are_refused(tmp_path: Path, name: str, values: NDArray[Any] | None) -> None:
    others = {each: kept for each, kept in arrays().items() if each != name}
    path = tmp_path / "features.npz"
    write_features(path, others if values is None else {**others, name: values})
    with pytest.raises(MapError, match=r"features.npz: .*delete it") as caught:
        read_features(path, 10, LIMITS)
    assert "\n" not in str(caught.value)
    assert caught.value.hint == "delete it, or build the map again"


def test_objects_are_never_loaded(path: Path) -> None:
    data = io.BytesIO()
    np.lib.format.write_array(data, np.array([{}], dtype=object), (1, 0), allow_pickle=True)
    packed_anew(path, zipfile.ZIP_STORED, {"raw.npy": data.getvalue()})
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


def packed_anew(
    path: Path, kind: int = zipfile.ZIP_LZMA, others: Mapping[str, bytes] = MappingProxyType({})
) -> None:
    with zipfile.ZipFile(path) as packed:
        members = {name: packed.read(name) for name in packed.namelist()}
    with zipfile.ZipFile(path, "w", kind) as packed:
        for name, data in {**members, **others}.items():
            packed.writestr(name, data)


HEADERS = (
    b"(" * 5000,
    b"(",
    b"{[1]: 2}",
    b"{1: 2, 'descr': 3}",
    b"  x\n y",
    b"{'descr': (), 'fortran_order': False, 'shape': (2, 0), }",
    b"{'descr': '<f2', 'fortran_order': False, 'shape': (True, 0), }",
)


@pytest.mark.parametrize("header", HEADERS)
def test_headers_that_numpy_fails_on_are_refused(path: Path, header: bytes) -> None:
    raw = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    packed_anew(path, zipfile.ZIP_STORED, {"raw.npy": raw})
    with pytest.raises(MapError, match=r"features.npz: is no zip file of arrays: delete it"):
        read_features(path, 10, LIMITS)


@pytest.mark.parametrize("keep", [0, 10, 400])
def test_a_file_cut_short_is_refused(path: Path, keep: int) -> None:
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(MapError, match="no zip file of arrays"):
        read_features(path, 10, LIMITS)


@pytest.mark.parametrize("damage", [encrypted, packed_anew])
def test_what_no_map_holds_is_refused(path: Path, damage: Callable[[Path], None]) -> None:
    damage(path)
    with pytest.raises(MapError, match=r"features.npz: is .*delete it"):
        read_features(path, 10, LIMITS)
