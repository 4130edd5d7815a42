"""Commands about the station: its ports, its mesh, boxes from a mesh of one's own."""

from pathlib import Path
from typing import Annotated

import tyro

from owm_envs.shell import terminal


def ports() -> None:
    """Print the docking ports and the poses to hold at them."""
    from rich.table import Table

    from owm_envs.station.ports import PORTS, goal_poses

    table = Table(title="Docking ports (station frame: x port side, y aft, z zenith; m; attitude scalar first)")
    for heading in ("", "port", "mechanism", "split", "hold position", "hold attitude"):
        table.add_column(heading, no_wrap=True)
    for index, (port, pose) in enumerate(zip(PORTS, goal_poses())):
        position = " ".join(f"{x:8.3f}" for x in pose[:3])
        attitude = " ".join(f"{x:7.4f}" for x in pose[3:])
        table.add_row(str(index), port.name, port.mechanism, port.split.replace("_", " "), position, attitude)
    terminal(width=110).print(table)


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
    from rich.table import Table

    from owm_envs.station.hull import save_hull
    from owm_envs.station.mesh import boxes_from_mesh, load_triangles

    console = terminal(stderr=True)
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
    terminal().print(table)
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
