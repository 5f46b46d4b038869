"""features.npz: the features of the scans that the classifiers of a map learned from.

Arrays of NumPy in a zip file, four kinds of scans: `raw`, `beside`, `along` and `cast` (F, n),
features in half precision, a column a scan, and with `_keyframes` behind the name (n,) their
keyframes. A file without `beside` is read, too.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from specmap_cli.core.errors import TOO_LARGE, MapError
from specmap_cli.core.files import read_bytes
from specmap_cli.core.settings import LimitsConfig

KINDS = ("raw", "beside", "along", "cast")
KEYFRAMES_OF = "_keyframes"
_END = ".npy"
_VERSION = (1, 0)  # of NumPy's format
# The headers that are written here. NumPy reads any literal of Python as one, with many errors.
_HEADER = re.compile(
    rb"\{'descr': '([<|][a-z]\d)', 'fortran_order': False, "
    rb"'shape': \((\d{1,12}),(?: (\d{1,12}))?\), \}\s*"
)
_PACKED = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 0x1
_MOST_MB = "limits.text_max_mb"

Arrays = Mapping[str, NDArray[Any]]

_NONE: Arrays = {
    "beside": np.zeros((0, 0), dtype=np.float16),
    "beside" + KEYFRAMES_OF: np.zeros(0, dtype=np.int32),
}


def write_features(path: Path, arrays: Arrays) -> None:
    """Write the features of all kinds of scans and their keyframes, by name."""
    with zipfile.ZipFile(path, "w") as packed:
        for name in sorted(arrays):
            data = io.BytesIO()
            np.lib.format.write_array(data, arrays[name], version=_VERSION, allow_pickle=False)
            info = zipfile.ZipInfo(name + _END)  # of no time: the same bytes whenever it is made
            packed.writestr(info, data.getvalue(), zipfile.ZIP_DEFLATED)


def read_features(path: Path, keyframes: int, limits: LimitsConfig) -> Arrays:
    """The arrays of a file, those of a map of so many keyframes.

    Raises MapError for a file that is damaged, or beyond its limits.
    """
    names = sorted(kind + what + _END for kind in KINDS for what in ("", KEYFRAMES_OF))
    older = [name for name in names if name.removesuffix(_END) not in _NONE]
    arrays: dict[str, NDArray[Any]] = dict(_NONE)
    try:
        data = read_bytes(path, limits.text_max_mb, _MOST_MB)
        with zipfile.ZipFile(io.BytesIO(data)) as packed:
            infos = packed.infolist()
            if sorted(info.filename for info in infos) not in (names, older):
                raise _damaged(path, "holds other arrays than those of a map")
            if any(i.flag_bits & _ENCRYPTED or i.compress_type not in _PACKED for i in infos):
                raise _damaged(path, "is packed in a way that is not read")
            if sum(info.file_size for info in infos) > limits.text_max_mb * 1e6:
                raise MapError(f"unpacked larger than {_MOST_MB}", where=path, code=TOO_LARGE)
            for info in infos:
                arrays[info.filename.removesuffix(_END)] = _array(packed.read(info))
    except OSError as error:
        raise MapError.of_system(error, "cannot be read", where=path) from None
    except (ValueError, EOFError, NotImplementedError, zipfile.BadZipFile, zlib.error):
        raise _damaged(path, "is no zip file of arrays") from None
    for kind in KINDS:
        found, own = arrays[kind], arrays[kind + KEYFRAMES_OF]
        if found.dtype != np.float16 or found.ndim != 2 or own.dtype != np.int32 or own.ndim != 1:
            raise _damaged(path, "holds arrays of another kind")
        if found.shape[1] != len(own) or not np.isfinite(found).all():
            raise _damaged(path, "holds features that are none")
        if len(own) and not 0 <= own.min() <= own.max() < keyframes:
            raise _damaged(path, "names keyframes that the map does not have")
    return arrays


def _array(data: bytes) -> NDArray[Any]:
    """An array of a file in NumPy's format, which runs no code; ValueError for any other."""
    file = io.BytesIO(data)
    version = np.lib.format.read_magic(file)
    start = file.tell() + 2  # behind the length of the header
    if version != _VERSION or len(data) < start:
        raise ValueError(version)
    end = start + int.from_bytes(data[file.tell() : start], "little")
    header = _HEADER.fullmatch(data[start:end])
    if header is None:
        raise ValueError(data[start:end])
    shape = [int(size) for size in header.groups()[1:] if size is not None]
    return np.frombuffer(data, dtype=header[1].decode(), offset=end).reshape(shape)


def _damaged(path: Path, what: str) -> MapError:
    return MapError(what, "delete it, or build the map again", where=path)
