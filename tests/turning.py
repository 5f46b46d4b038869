"""Constants of the package turned for a test, where nothing else shows what they do."""

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import TypeVar

import pytest
from pydantic import BaseModel

Section = TypeVar("Section", bound=BaseModel)
_patches: list[pytest.MonkeyPatch] = []  # of the test that runs


@contextmanager
def turned(home: str, **constants: object) -> Iterator[None]:
    """Constants of the module `specmap_cli.HOME` have other values, wherever they are imported."""
    owner = import_module(f"specmap_cli.{home}")
    with pytest.MonkeyPatch.context() as patch:
        for name, value in constants.items():
            usual = getattr(owner, name)
            for module in list(sys.modules.values()):
                if vars(module).get(name) is usual:
                    patch.setattr(module, name, value)
        yield


@contextmanager
def turning_back() -> Iterator[None]:
    """What `turn` and `configured` turn inside is as before in the end."""
    with pytest.MonkeyPatch.context() as patch:
        _patches.append(patch)
        yield
        _patches.pop()


def turn(package: str, **constants: object) -> None:
    """Until the test ends constants of a package have other values, in all of its modules.

    `look_scans` is `LOOK_SCANS` or `_LOOK_SCANS`.
    """
    modules = [m for n, m in sys.modules.items() if n.startswith(f"specmap_cli.{package}")]
    for name, value in constants.items():
        names = name.upper(), f"_{name.upper()}"
        found = [(m, each) for m in modules for each in names if each in vars(m)]
        assert found, f"{package} has no constant {name}"
        for module, each in found:
            _patches[-1].setattr(module, each, value)


def configured(section: type[Section], package: str, settings: Mapping[str, object]) -> Section:
    """Settings of a section; what is a constant of a package is turned until the test ends."""
    return altered(section(), package, settings)


def altered(config: Section, package: str, settings: Mapping[str, object]) -> Section:
    """The settings with others in their place, as `configured` has them."""
    known = {name: value for name, value in settings.items() if name in type(config).model_fields}
    turn(package, **{name: settings[name] for name in settings.keys() - known.keys()})
    return type(config).model_validate({**config.model_dump(), **known})
