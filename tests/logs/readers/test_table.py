"""The table of readers, and the documented example of one as a package of its own."""

import bz2
import gzip
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from specmap_cli.core.errors import UsageError
from specmap_cli.core.settings import LogConfig
from specmap_cli.logs import Message, open_log
from specmap_cli.logs.inspection import summarize
from specmap_cli.logs.opening import BUILT_IN, known_readers
from specmap_cli.logs.stream import SweepStream
from specmap_cli.logs.writer import convert
from tests.logs.recordings import refusal
from tests.plugins import install

Offer = Callable[[dict[str, str], str], None]

LINES = b"RANGES 1\n" + b"".join(
    b"%d 1.0 2.0 3.0 %d.5\n" % (1_700_000_000_000_000_000 + n * 100_000_000, n) for n in range(1, 6)
)
BARE = """
from specmap_cli.logs.readers import Contents, Recording
class {name}(Recording):
    {body}
    def close(self): pass
"""
WHOLE = "contents = Contents((), 0, 0)\n    def messages(self, topics=None): return iter(())"


@pytest.fixture
def offer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Offer:
    """Install a package that offers readers, by their names, for one test."""
    return partial(install, tmp_path, monkeypatch, "specmap.readers")


@pytest.fixture
def range_lines(offer: Offer) -> None:
    """The reader that docs/logs.md shows as an installed package."""
    shown = (Path(__file__).parents[3] / "docs" / "logs.md").read_text(encoding="utf-8")
    code = shown.partition("## A reader of your own")[2].partition("```python\n")[2]
    offer({"range_lines": "RangeLines"}, code.partition("```")[0])


@pytest.mark.usefixtures("range_lines")
def test_a_reader_of_another_package_reads_its_log(tmp_path: Path, path: Path) -> None:
    path.write_bytes(LINES)
    convert(path, tmp_path / "out.mcap")
    with open_log(path) as log, open_log(tmp_path / "out.mcap") as converted:
        assert list(log.messages()) == list(converted.messages())
        assert (log.format, converted.format) == ("range lines", "MCAP")
        stream = SweepStream(log, LogConfig())
        sweeps = list(stream)
        summary = summarize(log)
    assert stream.selection.topic.count == len(sweeps) == 5
    assert [s.planar.ranges.tolist() for s in sweeps] == [[1, 2, 3, n + 0.5] for n in range(1, 6)]
    assert summary.chosen == "scans from /scan (LaserScan, 5), no odometry, base frame laser"
    assert summary.next_command == f"specmap build {path}"
    assert summary.duration_s == pytest.approx(0.4)


@pytest.mark.usefixtures("range_lines")
@pytest.mark.parametrize("compress", [gzip.compress, bz2.compress])
def test_its_log_may_be_compressed(path: Path, compress: Callable[[bytes], bytes]) -> None:
    path.write_bytes(compress(LINES + b"oops\n"))
    before = set(Path(tempfile.gettempdir()).glob("specmap-*"))
    with open_log(path) as log:
        assert len(list(log.messages())) == len(list(log.messages())) == 5
        assert log.damage == [f"{path}: line 7 is damaged: one scan is lost"]
        assert log.paths == [path]
    assert set(Path(tempfile.gettempdir()).glob("specmap-*")) == before, "nothing is left behind"


@pytest.mark.usefixtures("range_lines")
def test_its_logs_are_found_in_a_folder(tmp_path: Path, drive: Path, driven: list[Message]) -> None:
    folder = tmp_path / "recording"
    folder.mkdir()
    (folder / "a.txt").write_bytes(LINES)
    (folder / "b.mcap").write_bytes(drive.read_bytes())
    (folder / "notes.txt").write_text("RANGES of hills\n")
    with open_log(folder) as log:
        assert log.format == "MCAP + range lines"
        assert log.paths == [folder / "b.mcap", folder / "a.txt"]
        assert log.contents.messages == len(driven) + 5


@pytest.mark.parametrize(
    ("body", "content"),
    [
        ('magic = b"\\x89MCAP"', b"\x89MCAP0\r\n"),
        (
            "@classmethod\n    def sniff(cls, head, file): return file.read_bytes()[-3:] == b'END'",
            bytes(10_000) + b"END",
        ),
    ],
    ids=["first bytes", "more than them"],
)
def test_an_installed_reader_is_asked_before_the_built_in_ones(
    path: Path, offer: Offer, body: str, content: bytes
) -> None:
    code = BARE.format(name="Dialect", body=f'format = "dialect"\n    {body}\n    {WHOLE}')
    offer({"dialect": "Dialect"}, code)
    assert list(known_readers()) == ["dialect", *BUILT_IN]
    path.write_bytes(content)
    with open_log(path) as log:
        assert log.format == "dialect"


def test_what_no_reader_knows_is_refused_with_the_formats_known(path: Path, offer: Offer) -> None:
    path.write_text("hello\n")
    known = "MCAP, rosbag2 (SQLite), ROS 1 bag or CARMEN log"
    said = f"{path}: a text file, not a recording; expected"
    assert refusal(path) == f"{said} {known}"
    body = f'format = "made-up"; magic = b"MADE"\n    {WHOLE}'
    offer({"made_up": "MadeUp"}, BARE.format(name="MadeUp", body=body))
    assert refusal(path) == f"{said} made-up, {known}"
    path.write_bytes(b"MAD")
    assert "cut off after 3 bytes; no message can be read" in refusal(path)


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("def Reader(file): ...", "is no class derived from specmap_cli.logs.readers.Recording"),
        (BARE.format(name="Reader", body='format = "x"; magic = b"x"'), "lacks contents, messages"),
        (BARE.format(name="Reader", body=WHOLE), "lacks format, magic or sniff"),
    ],
)
def test_a_broken_entry_point_is_one_line(drive: Path, offer: Offer, code: str, said: str) -> None:
    offer({"broken": "Reader"}, code)
    with pytest.raises(UsageError) as caught:
        open_log(drive)
    assert str(caught.value) == (
        f"the reader 'broken' of specmap.readers {said}; mend or remove its package"
    )


@pytest.mark.parametrize("name", sorted(BUILT_IN))
def test_no_reader_claims_rubbish(path: Path, name: str) -> None:
    rng = np.random.default_rng(3)
    for size in (1, 7, 64, 5000):
        path.write_bytes(rng.integers(0, 256, size, dtype=np.uint8).tobytes())
        assert not BUILT_IN[name].sniff(path.read_bytes()[:4096], path)
