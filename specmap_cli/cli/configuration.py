"""`specmap config`: the effective configuration as TOML."""

from __future__ import annotations

import typer

from specmap_cli.cli import options


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
    from specmap_cli.config import to_toml

    effective = options.effective(config, preset, settings)
    typer.echo(effective.model_dump_json(indent=2) if as_json else to_toml(effective), nl=as_json)
