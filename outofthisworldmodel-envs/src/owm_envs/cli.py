"""The `owm-envs` command."""

import tyro

from owm_envs import __version__
from owm_envs.commands.look import plot, render, replay
from owm_envs.commands.record import generate, merge
from owm_envs.commands.settings import schema, show, validate
from owm_envs.commands.share import download, push, verify
from owm_envs.commands.station import ports, station_export, station_import, station_show
from owm_envs.shell import run


def main(arguments: list[str] | None = None) -> None:
    """Run the command; see `owm_envs.shell.run`."""
    run("owm-envs", "Spacecraft docking environments.", __version__, _application, arguments)


def _application(arguments: list[str]) -> tyro.extras.SubcommandApp:
    config = tyro.extras.SubcommandApp()
    config.command(show)
    config.command(validate)
    config.command(schema)
    station = tyro.extras.SubcommandApp()
    station.command(station_export, name="export")
    station.command(station_import, name="import")
    station.command(station_show, name="show")
    app = tyro.extras.SubcommandApp()
    for command in (generate, merge, verify, push, download, render, replay, plot):
        app.command(command)
    app.command(config, name="config", help="Print or check a configuration.")
    app.command(ports)
    app.command(station, name="station", help="The station's mesh, its picture, and boxes from a mesh of your own.")
    return app


if __name__ == "__main__":
    main()
