"""Commands that show recorded flights."""

from pathlib import Path
from typing import Annotated

import tyro

from owm_envs.commands.progress import progress_bar


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
    with progress_bar("frames") as told:
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
        with progress_bar("frames") as told:
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
    with progress_bar("episodes") as told:
        figure = plot_dataset(run, split, told)
    save_figure(figure, out)
    print(out)
