"""Reading whole logs, undecoded, against the readers of `mcap` and `rosbags` on the same files.

python -m benchmarks.reading [--repeats 5]

Reads `sample_logs/office.mcap`, written anew in every format; with the real logs at hand also
fr079 and, of single compressed files, fr101_sparse. The figure to read is the ratio of the fastest
runs: below 1 this package is faster. CARMEN logs have no other reader in Python.
"""

from __future__ import annotations

import argparse
import gzip
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Reader as Rosbag2Reader
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from benchmarks.data import log_file
from specmap_cli.logs import Message, open_log
from specmap_cli.logs.readers.typestore import typestore

SAMPLE = Path(__file__).parents[1] / "sample_logs" / "office.mcap"

Read = Callable[[Path], int]
_COMPRESSIONS = [None, *Rosbag1Writer.CompressionFormat]


def by_us(path: Path) -> int:
    """Read every message of a log; how many there are."""
    with open_log(path) as log:
        return sum(1 for _ in log.messages())


def by_mcap(path: Path) -> int:
    """The same by the reader of the `mcap` package."""
    with path.open("rb") as file:
        return sum(1 for _ in make_reader(file).iter_messages())


def by_rosbags(path: Path) -> int:
    """The same by the readers of the `rosbags` package."""
    reader: Any = Rosbag2Reader(path) if path.is_dir() else Rosbag1Reader(path)
    with reader:
        return sum(1 for _ in reader.messages())


def write_bag(path: Path, messages: list[Message], compression: Any) -> None:
    """Messages as a ROS 1 bag."""
    writer = Rosbag1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        _write(writer, messages, lambda m: bytes(typestore().cdr_to_ros1(m.data, m.type)))


def write_rosbag2(path: Path, messages: list[Message]) -> None:
    """Messages as a rosbag2 directory with an SQLite file."""
    with Rosbag2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        _write(writer, messages, lambda m: m.data)


def _write(writer: Any, messages: list[Message], data: Callable[[Message], bytes]) -> None:
    types = {m.topic: m.type for m in messages}
    connections = {
        topic: writer.add_connection(topic, kind, typestore=typestore())
        for topic, kind in types.items()
    }
    for message in messages:
        writer.write(connections[message.topic], message.time_ns, data(message))


def formats_of(log: Path, folder: Path) -> Iterator[tuple[str, Path, Read | None]]:
    """(name, file, the other reader) of a log in every format."""
    yield f"{log.stem}, MCAP", log, by_mcap
    with open_log(log) as opened:
        messages = list(opened.messages())
    write_rosbag2(folder / log.stem, messages)
    yield f"{log.stem}, rosbag2 (SQLite)", folder / log.stem, by_rosbags
    for compression in _COMPRESSIONS:
        name = "plain" if compression is None else compression.name.lower()
        path = folder / f"{log.stem}_{name}.bag"
        write_bag(path, messages, compression)
        yield f"{log.stem}, ROS 1 bag, {name}", path, by_rosbags


def fastest(read: Read, path: Path, repeats: int) -> tuple[float, int]:
    """Seconds of the fastest of several readings, and the number of messages."""
    times: list[float] = []
    for _ in range(repeats):
        start = time.perf_counter()
        count = read(path)
        times.append(time.perf_counter() - start)
    return min(times), count


def report(name: str, path: Path, other: Read | None, repeats: int) -> None:
    """Measure one file and print its line."""
    ours, count = fastest(by_us, path, repeats)
    line = f"{name:32} {count:9,} {ours:8.3f} s"
    if other is not None:
        theirs, there = fastest(other, path, repeats)
        if there != count:
            raise SystemExit(f"{name}: read {count} messages, the other reader {there}")
        line += f" {theirs:8.3f} s {ours / theirs:6.2f}"
    print(line, flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    repeats = parser.parse_args().repeats
    print(f"{'':32} {'messages':>9} {'specmap':>10} {'other':>10} {'ratio':>6}")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for case in formats_of(SAMPLE, folder):
            report(*case, repeats)
        for case in formats_of(log_file("fr079"), folder):
            report(*case, repeats)
        packed = log_file("fr079").parent / "fr101_sparse.log.gz"
        plain = folder / "fr101_sparse.log"
        plain.write_bytes(gzip.decompress(packed.read_bytes()))
        report("fr101_sparse, CARMEN", plain, None, repeats)
        report("fr101_sparse, CARMEN in gzip", packed, None, repeats)


if __name__ == "__main__":
    main()
