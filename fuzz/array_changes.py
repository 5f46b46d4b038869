"""Mutations of a zip file of NumPy's arrays: their kinds, shapes and values, and the zip itself."""

from __future__ import annotations

import io
import random
import warnings
import zipfile

import numpy as np

_KINDS = (np.float16, np.float32, np.complex64, np.int8, np.int32, np.uint64, "S3", "M8[s]")
_VALUES = (np.nan, np.inf, -1, 0, 2**31 - 1, -(2**31))
_SHAPES = ((0,), (0, 0), (1,), (1, 1), (3, 0), (2, 2, 2), ())
_HEADERS = (
    b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
    b"{'descr': '<f2', 'fortran_order': True, 'shape': (2, 2), }",
    b"{'descr': '<f2', 'fortran_order': False, 'shape': (-1, 2), }",
    b"{'descr': '<f2', 'fortran_order': False, 'shape': (1000000000000, 2), }",
    b"{'descr': [('a', '<f2')], 'fortran_order': False, 'shape': (2,), }",
    b"{'descr': (), 'fortran_order': False, 'shape': (2, 2), }",
    b"{[1]: 2}",
    b"(",
    b"(" * 3000,
    b"",
)


def change_arrays(rng: random.Random, data: bytes) -> tuple[bytes, str]:
    """The file with one of its arrays changed, and a word on it."""
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        members = {info.filename: packed.read(info) for info in packed.infolist()}
    name = rng.choice(sorted(members))
    kind = rng.choice(["dropped", "twice", "header", "kind", "value", "shape", "cut"])
    if kind == "header":
        header = rng.choice(_HEADERS)
        length = len(header).to_bytes(2, "little")
        members[name] = b"\x93NUMPY\x01\x00" + length + header + members[name][128:]
    elif kind == "cut":
        members[name] = members[name][: rng.randrange(len(members[name]))]
    elif kind in ("kind", "value", "shape"):
        members[name] = _other_array(rng, kind)
    order = [n for n in members if not (kind == "dropped" and n == name)]
    order += [name] if kind == "twice" else []
    compression = rng.choice([*[zipfile.ZIP_DEFLATED] * 3, zipfile.ZIP_BZIP2])
    return _zipped(members, order, compression), f"{name}: {kind}"


def _other_array(rng: random.Random, kind: str) -> bytes:
    """An array of another kind, shape or value than those of a map."""
    made = np.zeros(rng.choice(_SHAPES) if kind == "shape" else (4, 4), dtype=np.float16)
    if kind == "kind":
        made = made.astype(rng.choice(_KINDS))
    if kind == "value":
        with np.errstate(over="ignore", invalid="ignore"):
            made = np.full((4, 4), rng.choice(_VALUES)).astype(np.float16)
    file = io.BytesIO()
    np.lib.format.write_array(file, made, (1, 0), allow_pickle=False)
    return file.getvalue()


def _zipped(members: dict[str, bytes], order: list[str], compression: int) -> bytes:
    file = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(file, "w") as packed:
        warnings.simplefilter("ignore")  # of names that come twice
        for name in order:
            packed.writestr(zipfile.ZipInfo(name), members[name], compression)
    return file.getvalue()
