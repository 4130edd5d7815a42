"""A flight as a recording for the Rerun viewer; needs the extra `rerun`."""

from pathlib import Path
from typing import Any

import numpy as np

from owm_envs.camera.views import camera
from owm_envs.files import output_file, write_atomically
from owm_envs.replay.recording import CURVES, Recording
from owm_envs.station import CHASER, PARTS, PORTS
from owm_envs.station.mesh import UP, scene
from owm_envs.view import View
from owm_envs.words import install

_TIME = "flight"
_COLOURS = {"x": (255, 122, 114), "y": (123, 224, 138), "z": (111, 182, 255)}
_PATH, _GOAL, _PORT, _HULL = (255, 214, 92), (96, 240, 160), (111, 182, 255), (74, 127, 181)
_REACH = 6.0 / 1600.0  # m of arrow for a newton


def require_rerun() -> Any:
    """Rerun's package.

    Raises:
        ImportError: it is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise ImportError(f"Rerun recordings need rerun-sdk ({error}): {install('rerun')}") from error
    return rerun


def save_rrd(path: str | Path, recording: Recording) -> Path:
    """Write a flight as a Rerun recording, whole or not at all: station, path, poses over time, curves and frames.

    Raises:
        ImportError: rerun-sdk or trimesh is missing.
        ValueError, NotADirectoryError, PermissionError: as `output_file`.
    """
    rerun, path = require_rerun(), output_file(path, ".rrd")
    stream = rerun.RecordingStream("owm-envs replay")
    sink = stream.binary_stream()
    stream.send_blueprint(_blueprint(recording))
    _log(rerun, stream, recording)
    data = sink.read()
    write_atomically(path, lambda file: file.write(data))
    return path


def _log(rr: Any, stream: Any, recording: Recording) -> None:
    episode, boxes = recording.episode, recording.boxes
    seen = View.of(episode.true_state)
    stream.send_recording_name(recording.title)
    stream.log("station", rr.ViewCoordinates.LBU, static=True)  # x to port, y aft, z up
    for name, parts in (("station/mesh", PARTS), ("station/chaser/mesh", CHASER)):
        # The mesh is glTF's, y up; Rerun takes it as it is.
        mesh = scene(parts).export(file_type="glb")
        stream.log(name, rr.Asset3D(contents=mesh, media_type="model/gltf-binary"), static=True)
        stream.log(name, rr.Transform3D(mat3x3=UP["y"]), static=True)
    sizes, centres = np.diff(boxes, axis=1)[:, 0], boxes.mean(axis=1)
    stream.log("station/hull", rr.Boxes3D(centers=centres, sizes=sizes, colors=[_HULL]), static=True)
    normals = np.array([port.normal for port in PORTS])
    arrows = rr.Arrows3D(
        origins=[port.interface for port in PORTS],
        vectors=10.0 * normals,
        labels=[port.name for port in PORTS],
        colors=[_GOAL if number == episode.port else _PORT for number in range(len(PORTS))],
    )
    stream.log("station/ports", arrows, static=True)
    stream.log("station/goal", rr.Points3D([episode.goal_pose[:3]], colors=[_GOAL], radii=0.4), static=True)
    stream.log("station/path", rr.LineStrips3D([seen.position], colors=[_PATH]), static=True)

    when = [rr.TimeColumn(_TIME, duration=recording.times)]
    turned = np.roll(seen.attitude, -1, axis=1)  # Rerun's quaternions have their scalar last
    stream.send_columns("station/chaser", when, rr.Transform3D.columns(translation=seen.position, quaternion=turned))
    force = np.pad(episode.action[:, :3], ((0, 1), (0, 0)))
    stream.send_columns(
        "station/chaser/force",
        when,
        rr.Arrows3D.columns(vectors=_REACH * force, colors=np.full((len(force), 3), (255, 154, 60), np.uint8)),
    )
    columns = recording.columns
    for curve in CURVES:
        for line in curve.lines:
            place, axis = _place(curve.label, line), line.partition("_")[2]
            colour = [_COLOURS[axis]] if axis else None
            name = f"{axis or curve.label} [{curve.unit}]"
            stream.log(place, rr.SeriesLines(names=[name], colors=colour), static=True)
            stream.send_columns(place, when, rr.Scalars.columns(scalars=columns[line]))
    lens, nose = camera("chaser_fpv"), "station/chaser/nose"
    turned = np.roll(np.asarray(lens.attitude), -1)
    stream.log(nose, rr.Transform3D(translation=np.asarray(lens.position), quaternion=turned), static=True)
    if recording.pictures is not None:
        rows, images, _ = recording.pictures
        height, width = images.shape[1:3]
        pinhole = rr.Pinhole(
            fov_y=float(lens.field),
            aspect_ratio=width / height,
            resolution=(width, height),
            camera_xyz=rr.ViewCoordinates.LUF,
            image_plane_distance=3.0,
        )
        stream.log(nose, pinhole, static=True)
        for row, image in zip(rows, images):
            stream.set_time(_TIME, duration=float(recording.times[row]))
            stream.log(nose, rr.Image(image).compress(jpeg_quality=90))


def _place(label: str, line: str) -> str:
    return f"curves/{label.split(',')[0].replace(' ', '_')}" + (f"/{line}" if "_" in line else "")


def _blueprint(recording: Recording) -> Any:
    from rerun import blueprint

    curves = [
        blueprint.TimeSeriesView(name=f"{curve.label} [{curve.unit}]", origin=_place(curve.label, ""))
        for curve in CURVES
    ]
    pictures = []
    if recording.pictures is not None:
        pictures = [blueprint.Spatial2DView(name="camera", origin="station/chaser/nose")]
    space = blueprint.Spatial3DView(name="station frame", origin="station")
    return blueprint.Blueprint(
        blueprint.Horizontal(space, blueprint.Vertical(*pictures, *curves), column_shares=[3, 1]), collapse_panels=True
    )
