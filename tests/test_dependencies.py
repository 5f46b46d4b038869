"""What the project stands on: declared, pinned at both ends, documented, and nothing else."""

import re
import sys
import tomllib
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

from specmap_cli.core.process import STANDS_ON
from tests.test_architecture import MODULES, imports

ROOT = Path(__file__).parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
RUNTIME = [*map(Requirement, PROJECT["dependencies"])]
EXTRAS = {name: [*map(Requirement, of)] for name, of in PROJECT["optional-dependencies"].items()}
BOTH_ENDS = [*RUNTIME, *EXTRAS["dev"], *EXTRAS["batch"]]  # tested with the lowest versions, too
PINNED = [*BOTH_ENDS, *EXTRAS["consumers"]]
DECLARED = [*PINNED, *EXTRAS["rerun"]]
# For the site and for archives: pinned as the others, and no part of what is tested at both ends.
TOOLS = [*EXTRAS["docs"], *EXTRAS["dist"]]


def pins(name: str) -> dict[str, Version]:
    """The versions that a file of constraints pins."""
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    pinned = [line.split("==") for line in lines if not line.startswith("#")]
    return {canonicalize_name(name): Version(version) for name, version in pinned}


def floor(requirement: Requirement) -> Version:
    """The lowest version that a requirement allows; each has one."""
    (lowest,) = (each.version for each in requirement.specifier if each.operator == ">=")
    return Version(lowest)


def test_the_lowest_pins_are_the_floors_and_the_usual_ones_are_allowed() -> None:
    lowest = pins("constraints-lowest.txt")
    apart = [one for one in BOTH_ENDS if lowest.get(canonicalize_name(one.name)) != floor(one)]
    assert apart == [], "run `make constraints-lowest`"
    usual = pins("constraints.txt")
    pinned = [(one, usual[canonicalize_name(one.name)]) for one in [*PINNED, *TOOLS]]
    assert [one for one, version in pinned if version not in one.specifier] == []
    assert [one for one in PINNED if usual[canonicalize_name(one.name)] < floor(one)] == []


def test_the_version_names_all_that_is_needed_to_run() -> None:
    assert list(STANDS_ON) == sorted(requirement.name for requirement in RUNTIME)


def test_the_package_imports_what_is_declared_and_nothing_else() -> None:
    imported = {name.split(".")[0] for path in MODULES for _, name in imports(path)}
    # geopandas is for who has it: `Map.to_geopandas` says what is missing
    foreign = imported - sys.stdlib_module_names - {"specmap_cli", "geopandas"}
    distributions = dict(metadata.packages_distributions())
    declared = {canonicalize_name(requirement.name) for requirement in RUNTIME}
    extras = [*EXTRAS["rerun"], *EXTRAS["batch"]]
    declared |= {canonicalize_name(requirement.name) for requirement in extras}
    distributions |= {"rerun": ["rerun-sdk"]}  # which need not be installed
    distributions |= {name: [name] for name in ("distributed", "fsspec", "psutil", "pyarrow")}
    distributions |= {"dask": ["distributed"]}  # it comes with it
    undeclared = {
        name for name in foreign if not {*map(canonicalize_name, distributions[name])} & declared
    }
    assert undeclared == set()


def test_the_documents_say_what_each_is_for_and_nothing_is_declared_twice() -> None:
    text = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    names = [requirement.name for requirement in [*DECLARED, *TOOLS]]
    said = [name for name in names if re.search(rf"(?<![\w-]){re.escape(name)}(?![\w-])", text)]
    assert said == names
    assert len({*map(canonicalize_name, names)}) == len(names)


def test_every_python_promised_is_allowed() -> None:
    promised = [
        line.rsplit(" ", 1)[1]
        for line in PROJECT["classifiers"]
        if re.search(r"Python :: 3\.\d+$", line)
    ]
    lowest, *_ = promised
    assert promised == ["3.11", "3.12", "3.13"]
    assert PROJECT["requires-python"] == f">={lowest}"
