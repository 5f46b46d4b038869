"""`specmap config`: the effective configuration as TOML."""

from __future__ import annotations

from specmap_cli.cli.options import Common, Settings
from specmap_cli.cli.streams import print_text


def config(settings: Settings, common: Common) -> None:
    """Print the configuration in force as TOML.

    Every key with its value and what it is for, ready to edit and give back with --config.

    \b
    specmap config > specmap.toml
    specmap config --preset paper --set seed=3
    """
    from specmap_cli.core.toml import to_toml

    effective = settings.load()
    as_json = common.as_json
    print_text(effective.model_dump_json(indent=2) + "\n" if as_json else to_toml(effective))
