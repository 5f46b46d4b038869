"""`specmap config`: the effective configuration as TOML."""

from __future__ import annotations

from specmap_cli.cli import options
from specmap_cli.cli.stdout import print_text


def show_config(
    config: options.ConfigFile = None,
    preset: options.Preset = None,
    settings: options.Settings = None,
    as_json: options.Json = False,
) -> None:
    """Print the configuration in force as TOML.

    Every key with its value and what it is for, ready to edit and give back with --config.

    \b
    specmap config > specmap.toml
    specmap config --preset paper --set seed=3
    """
    from specmap_cli.core.config import load_config
    from specmap_cli.core.tomltext import to_toml

    effective = load_config(config, preset, options.overrides(settings))
    print_text(effective.model_dump_json(indent=2) + "\n" if as_json else to_toml(effective))
