"""Commands about configurations."""

from pathlib import Path
from typing import Annotated

import tyro


def show(config: Annotated[Path | None, tyro.conf.Positional] = None, preset: str = "data") -> None:
    """Print a complete configuration as TOML, each number with its unit and bounds.

    Args:
        config: TOML file to complete; the preset alone if absent.
        preset: data or rl.
    """
    from owm_envs.config import load_config

    print(load_config(config, preset=preset).to_toml(notes=True), end="")


def schema() -> None:
    """Print the JSON schema of configuration files, for editors."""
    import json

    from owm_envs.config import DockingConfig
    from owm_envs.config.text import json_schema

    print(json.dumps(json_schema(DockingConfig), indent=1))


def validate(config: Annotated[Path, tyro.conf.Positional]) -> None:
    """Check a configuration file and print what it changes; a mistake is named, with bounds or the nearest known key.

    Args:
        config: TOML file.
    """
    from owm_envs.config import DockingConfig, load_config
    from owm_envs.config.text import changes

    try:
        settings = load_config(config)
    except ValueError as error:
        raise ValueError(f"{config}: {error}") from None
    print(f"{config}: valid, a configuration of {settings.fidelity}")
    for line in changes(settings, DockingConfig(fidelity=settings.fidelity)):
        print(f"  {line}")
