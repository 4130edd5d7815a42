"""The `owm-envs` command. Heavy imports wait inside the commands, so that `--help` is quick."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import tyro

from owm_envs import __version__
from owm_envs.commands.record import generate, merge
from owm_envs.shell import resumable, run


def verify(dataset: Annotated[str, tyro.conf.Positional]) -> None:
    """Check a dataset: hashes, counts, each row, statistics, each frame, dynamics, noise and a picture drawn anew.

    Ends with 1 if something is wrong, and says what.

    Args:
        dataset: Folder of a dataset, or its name on the hub, user/name with an optional @revision.
    """
    from rich.console import Console
    from rich.table import Table

    from owm_envs.datasets.verify import WRONG, verify

    console = Console(stderr=True)
    with console.status("") as status:
        report = verify(dataset, progress=status.update)
    table = Table(title=dataset)
    for heading in ("check", "split", "result", "figure"):
        table.add_column(heading, overflow="fold")
    for check, split, result, told in report.findings:
        table.add_row(check, split, result, "" if result == WRONG else told)
    Console().print(table)
    for finding in report.wrong:
        print(f"wrong: {finding.told}", file=sys.stderr)
    if not report.sound:
        raise SystemExit(1)


def render(
    run: Annotated[Path, tyro.conf.Positional],
    out: Path | None = None,
    split: str | None = None,
    episodes: tuple[int, ...] = (),
    camera: str = "chaser_fpv",
    size: int = 256,
    fps: float = 20.0,
    speed: float = 10.0,
    sheet: bool = False,
) -> None:
    """Film recorded flights: an MP4 for each episode, or a contact sheet.

    Args:
        run: Folder of a dataset, as `owm-envs generate` makes it.
        out: Folder for the files; RUN-films by default.
        split: train or val; val by default where there is one.
        episodes: Their numbers; the first by default.
        camera: chaser_fpv, chaser_isometric, chaser_top, station_isometric, station_top or station_fpv.
        size: Rows and columns of a picture, pixels.
        fps: Frames a second of the film.
        speed: Seconds of flight in a second of film.
        sheet: Draw a dozen pictures of each flight as one PNG, and no film.
    """
    from owm_envs.film import film_run

    if split is None and (run / "val" / "meta" / "info.json").is_file():
        split = "val"
    folder = run.with_name(f"{run.resolve().name}-films") if out is None else out
    with _progress("frames") as told:
        files = film_run(
            run,
            folder,
            split=split,
            episodes=episodes,
            name=camera,
            size=size,
            fps=fps,
            speed=speed,
            sheet=sheet,
            progress=told,
        )
    for file in files:
        print(file)


def push(
    run: Annotated[Path, tyro.conf.Positional],
    name: Annotated[str, tyro.conf.Positional],
    together: bool = False,
    private: bool = False,
    dry_run: bool = False,
) -> None:
    """Publish a recorded dataset on the Hugging Face hub: USER/NAME-train and USER/NAME-val.

    Each is a LeRobot dataset of its own, with a card and the tag that LeRobot looks for. What is there already is not
    sent again, so that the same command goes on where it was interrupted. Log in with `hf auth login`.

    Args:
        run: Folder of a dataset, as `owm-envs generate` makes it; one that differs from its manifest is refused.
        name: user/name.
        together: One repository, user/name, with the splits in folders.
        private: Make new repositories private.
        dry_run: List repositories, tags, files and sizes; send nothing.
    """
    from owm_envs import hub
    from owm_envs.datasets.publish import repositories

    planned = repositories(run, name, together=together)
    resumable()
    for repository in planned:
        print(repository.listing() if dry_run else hub.push(repository, private=private))


def download(name: Annotated[str, tyro.conf.Positional], out: Path, revision: str | None = None) -> None:
    """Copy a dataset of the Hugging Face hub to a folder, at one commit, every file checked.

    Where there is no repository user/name, user/name-train and user/name-val are taken for its splits. A killed call is
    resumed by the same command. What has been fetched once comes from the cache where the hub cannot be reached.

    Args:
        name: user/name.
        out: Folder to make.
        revision: Branch, tag or commit; the main branch by default.
    """
    import sys

    from owm_envs.datasets.fetch import download as fetch

    resumable()
    for repository, commit in fetch(name, out, revision, lambda text: print(text, file=sys.stderr)).items():
        print(f"{out}: {repository} at {commit}")


def replay(
    run: Annotated[Path, tyro.conf.Positional],
    episode: int = 0,
    split: str | None = None,
    out: Path = Path("replay.html"),
    title: str | None = None,
    frames: bool = False,
    size: int = 256,
    fps: float = 2.0,
    rerun: bool = False,
) -> None:
    """Write a recorded flight as one page that opens from disk: station, chaser, path, time line, curves.

    Camera frames that were recorded are in the page. Without any, the page draws the nose camera itself as it plays.

    Args:
        run: Folder of a dataset as `owm-envs generate` makes it, or what `owm fly` wrote.
        episode: Its number, from 0.
        split: train or val; val by default where there is one.
        out: File to write, .html.
        title: What to call the flight.
        frames: Draw the nose camera's frames with the environment's renderer, in place of recorded ones; takes a while.
        size: Rows and columns of such a frame, pixels.
        fps: Such frames a second of flight.
        rerun: Write a recording for the Rerun viewer too, beside the page, .rrd (extra `rerun`).
    """
    from dataclasses import replace

    from owm_envs.files import output_file
    from owm_envs.replay import film, load, save_page, save_rrd
    from owm_envs.replay.rrd import require_rerun

    out = output_file(out, ".html")
    if rerun:
        require_rerun()
    flight = load(run, split, episode, title)
    if frames:
        with _progress("frames") as told:
            flight = replace(flight, pictures=film(flight, size, fps, told))
    files = [save_page(out, flight), *([save_rrd(out.with_suffix(".rrd"), flight)] if rerun else [])]
    for file in files:
        print(f"{file}: {file.stat().st_size / 1e6:.1f} MB")


def plot(run: Annotated[Path, tyro.conf.Positional], out: Path = Path("dataset.png"), split: str | None = None) -> None:
    """Draw a dataset: flights by policy with their ends, outcomes, lengths, and what the sensors added to the truth.

    Args:
        run: Folder of a dataset, as `owm-envs generate` makes it.
        out: PNG file to write.
        split: train or val; train by default where there is one.
    """
    from owm_envs.datasets.plot import plot_dataset
    from owm_envs.figures import save_figure
    from owm_envs.files import output_file

    out = output_file(out, ".png")
    if split is None and (run / "train" / "meta" / "info.json").is_file():
        split = "train"
    with _progress("episodes") as told:
        figure = plot_dataset(run, split, told)
    save_figure(figure, out)
    print(out)


@contextmanager
def _progress(what: str) -> Iterator[Callable[[int, int | None], None]]:
    """A bar that is told of how many are done, of how many."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn

    columns = [SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()]
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


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


def ports() -> None:
    """Print the docking ports and the poses to hold at them."""
    from rich.console import Console
    from rich.table import Table

    from owm_envs.station.ports import PORTS, goal_poses

    table = Table(title="Docking ports (station frame: x port side, y aft, z zenith; m; attitude scalar first)")
    for heading in ("", "port", "mechanism", "split", "hold position", "hold attitude"):
        table.add_column(heading, no_wrap=True)
    for index, (port, pose) in enumerate(zip(PORTS, goal_poses())):
        position = " ".join(f"{x:8.3f}" for x in pose[:3])
        attitude = " ".join(f"{x:7.4f}" for x in pose[3:])
        table.add_row(str(index), port.name, port.mechanism, port.split.replace("_", " "), position, attitude)
    Console(width=110).print(table)


def station_export(out: Annotated[Path, tyro.conf.Positional], chaser: bool = False) -> None:
    """Write the station's table of parts as a mesh (binary glTF, y up).

    Args:
        out: File to write, .glb.
        chaser: Write the chaser, a Dragon, instead.
    """
    from owm_envs.station import CHASER, PARTS
    from owm_envs.station.mesh import export

    parts = CHASER if chaser else PARTS
    print(f"{out}: {len(parts)} parts, {export(out, parts) / 1e3:.0f} kB")


def station_import(
    mesh: Annotated[Path, tyro.conf.Positional],
    boxes: int = 313,
    voxel: float = 0.5,
    scale: float = 1.0,
    up: str | None = None,
    out: Path | None = None,
) -> None:
    """Turn a mesh of your own into collision boxes, and report how well they fit.

    Args:
        mesh: File that trimesh reads (glb, obj, stl, ply, ...), in the station frame once scaled and turned.
        boxes: Number of boxes to make.
        voxel: Edge of a voxel in metres.
        scale: Metres per unit of the file.
        up: The file's axis that points to zenith: x, y or z; y for glTF and z for other files by default.
        out: File to write the boxes to, a line each; not written if absent.
    """
    from rich.console import Console
    from rich.table import Table

    from owm_envs.station.hull import save_hull
    from owm_envs.station.mesh import boxes_from_mesh, load_triangles

    console = Console(stderr=True)
    triangles = load_triangles(mesh, scale, up)
    report = boxes_from_mesh(triangles, boxes, voxel, progress=lambda text: console.print(f"{text} ..."))
    table = Table(title=str(mesh), show_header=False)
    for name, value in (
        ("triangles", f"{report.triangles:,}"),
        ("voxels on the surface", f"{report.voxels:,} of {voxel} m"),
        ("boxes", f"{len(report.boxes)}"),
        ("coverage of the surface", f"{100.0 * report.covered:.2f} %"),
        ("excess, mean", f"{report.excess_mean:.2f} m"),
        ("excess, 99th percentile", f"{report.excess_p99:.2f} m"),
        ("farthest corner from the origin", f"{report.reach:.1f} m"),
    ):
        table.add_row(name, value)
    Console().print(table)
    if out is not None:
        save_hull(out, report.boxes, f"{len(report.boxes)} boxes from {mesh.name}")
        print(f"{out}: {len(report.boxes)} boxes")


def station_show(
    out: Annotated[Path, tyro.conf.Positional] = Path("station.png"),
    camera: str = "station_isometric",
    size: tuple[int, int] = (1600, 1000),
    boxes: bool = True,
    ports: bool = True,
    chaser: str | None = None,
    hull: Path | None = None,
) -> None:
    """Draw the station with its collision boxes, ports and corridors, and report how well the boxes fit.

    Args:
        out: PNG file to write.
        camera: A camera's name; an unknown one has all of them listed.
        size: Width and height in pixels.
        boxes: Draw the boxes.
        ports: Draw ports and corridors.
        chaser: Port at whose hold pose a chaser is to be; the chaser's cameras take the first port.
        hull: File of boxes that `station import --out` wrote, in place of the station's own.
    """
    import cv2

    from owm_envs.camera.schematic import draw_station
    from owm_envs.camera.views import camera as named
    from owm_envs.station import PARTS, PORTS, hull_boxes, hull_quality, load_hull, port_index

    if out.suffix.lower() != ".png":
        raise ValueError(f"the picture must be a .png file; got {out}")
    corners = hull_boxes() if hull is None else load_hull(hull)
    shot = named(camera, width=size[0], height=size[1], samples=2)
    if chaser is None and shot.mount == "chaser":
        chaser = PORTS[0].name
    at = None if chaser is None else port_index(chaser)
    image = draw_station(shot, at, corners if boxes else None, ports)
    _, data = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])
    out.write_bytes(data.tobytes())
    quality = hull_quality(corners)
    print(
        f"{out}: {len(PARTS)} parts, {quality.boxes} boxes covering {100.0 * quality.covered:.2f} % of their surface; "
        f"excess {quality.excess_mean:.2f} m mean, {quality.excess_p99:.2f} m at the 99th percentile"
    )


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
    app.command(generate)
    app.command(verify)
    app.command(merge)
    app.command(render)
    app.command(push)
    app.command(download)
    app.command(replay)
    app.command(plot)
    app.command(config, name="config", help="Print or check a configuration.")
    app.command(ports)
    app.command(station, name="station", help="The station's mesh, its picture, and boxes from a mesh of your own.")
    return app


if __name__ == "__main__":
    main()
