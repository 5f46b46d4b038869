"""Wheel and source archive hold the package and its data alone; what is no release is refused."""

import importlib.util
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from benchmarks.release import faults, tried_on
from tests.conftest import SAMPLE_LOGS

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "specmap_cli"
FOLDERS = {"specmap_cli", "tests", "fuzz", "docs", "benchmarks", "sample_logs"}
BESIDE = {
    *("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE", "pyproject.toml", "Makefile"),
    *("constraints.txt", "constraints-lowest.txt", "mkdocs.yml", "Containerfile"),
}
BY_HATCHLING = {"PKG-INFO", ".gitignore"}


@pytest.fixture(scope="module")
def archives(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A directory with both, made without a network."""
    if importlib.util.find_spec("hatchling") is None:
        pytest.skip("archives are made by hatchling: make dist installs it")
    folder = tmp_path_factory.mktemp("archives")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-d", str(folder)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    return folder


def of_the_package() -> set[str]:
    """What belongs to the package: its code and its data, as the directory has them."""
    return {
        path.relative_to(ROOT).as_posix()
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }


def test_the_package_has_data() -> None:
    data = {path for path in of_the_package() if not path.endswith(".py")}
    assert {
        "specmap_cli/py.typed",
        "specmap_cli/maps/topology.schema.json",
        "specmap_cli/schemas/build.schema.json",
    } <= data


def test_the_wheel_holds_the_package_and_nothing_else(archives: Path) -> None:
    (wheel,) = archives.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
        about = {name for name in names if ".dist-info/" in name}
        (entry,) = (name for name in about if name.endswith("entry_points.txt"))
        points = archive.read(entry).decode()
    assert names - about == of_the_package()
    told = "METADATA WHEEL RECORD entry_points.txt licenses/LICENSE"
    assert {name.split("/", 1)[1] for name in about} == set(told.split())
    assert points == "[console_scripts]\nspecmap = specmap_cli.cli:main\n"
    assert wheel.stat().st_size < 2e6


def test_the_source_archive_holds_what_is_needed_to_test_it(archives: Path) -> None:
    (source,) = archives.glob("*.tar.gz")
    with tarfile.open(source) as archive:
        names = {member.name.split("/", 1)[1] for member in archive if member.isfile()}
    assert of_the_package() <= names
    assert {name.split("/")[0] for name in names} - BY_HATCHLING == FOLDERS | BESIDE
    assert not {name for name in names if "__pycache__" in name}


@pytest.mark.parametrize(
    ("changes", "changelog", "said"),
    [
        ("", "# Changelog\n## 1.0.0 (2026-11-23)\n## 0.9.0 (2026-01-01)\n", []),
        (" M x.py\n", "## 1.0.0 (2026-11-23)\n", ["the tree is not clean: M x.py"]),
        ("", "## Unreleased\n## 1.0.0 (2026-11-23)\n", ["CHANGELOG.md does not begin with"]),
        ("", "## 1.0.01 (2026-11-23)\n", ["CHANGELOG.md does not begin with"]),
    ],
)
def test_what_is_no_release_is_refused(changes: str, changelog: str, said: list[str]) -> None:
    found = faults(changes, changelog, "1.0.0")
    assert len(found) == len(said)
    assert all(one.startswith(words) for one, words in zip(found, said, strict=True))


def test_a_python_that_is_not_there_is_told() -> None:
    told = tried_on("python3.no", SAMPLE_LOGS / "office.mcap")
    assert told == "not tried: it is not on this machine"
