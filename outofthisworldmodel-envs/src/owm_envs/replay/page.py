"""A flight as one HTML page that opens from disk and asks nothing of the network."""

import base64
import html
import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from owm_envs.camera.views import camera
from owm_envs.files import output_file, write_atomically
from owm_envs.replay.recording import CURVES, HELD, Pictures, Recording
from owm_envs.station import CHASER, MATERIALS, PARTS, PORTS, Part

_SCRIPTS = ("flight.js", "curves.js", "scene.js", "sky.js", "stage.js", "page.js")
_EARTH = (2048, 1024)
_APART = 10.0  # s between two places of the Sun
_GOOD, _BAD = ("docked",), ("collided", "escaped", "invalid_action", "diverged")


def save_page(path: str | Path, recording: Recording) -> Path:
    """Write a flight as a page, whole or not at all.

    Returns:
        Where it is.

    Raises:
        ValueError, NotADirectoryError, PermissionError: as `output_file`.
    """
    path, text = output_file(path, ".html"), page(recording)
    write_atomically(path, lambda file: file.write(text), text=True)
    return path


def page(recording: Recording) -> str:
    """The page's text."""
    # "<" appears in JSON's strings alone: escaped, no text can end the element that holds it.
    data = json.dumps(page_data(recording), separators=(",", ":")).replace("<", "\\u003c")
    parts = {
        "title": html.escape(recording.title),
        "css": _asset("replay.css"),
        "three": _asset("three.min.js"),
        "script": "\n".join(_asset(name) for name in _SCRIPTS),
        "data": data,
    }
    first, *rest = _asset("page.html").split("{{")
    return first + "".join(parts[name] + after for name, after in (piece.split("}}", 1) for piece in rest))


def page_data(recording: Recording) -> dict[str, Any]:
    """What the page's scripts read, JSON-able; arrays are base64 of little-endian float32."""
    episode, config = recording.episode, recording.config
    return {
        "facts": _facts(recording),
        "times": packed(recording.times),
        "state": packed(episode.true_state),
        "columns": {name: packed(values) for name, values in recording.columns.items()},
        "held": HELD,
        "curves": [{"label": c.label, "unit": c.unit, "columns": c.lines, "log": c.log} for c in CURVES],
        "limits": [config.chaser.force_limit, config.chaser.torque_limit],
        "goal": episode.goal_pose.tolist(),
        "port": episode.port,
        "ports": [{"name": port.name, "interface": port.interface, "normal": port.normal} for port in PORTS],
        "boxes": packed(recording.boxes),
        "parts": {"station": [_part(part) for part in PARTS], "chaser": [_part(part) for part in CHASER]},
        "materials": {name: (row.colour, row.metallic, row.roughness) for name, row in MATERIALS.items()},
        "cameras": {
            name: _lens(camera(of, port=PORTS[episode.port].name))
            for name, of in (("chase", "chaser_isometric"), ("nose", "chaser_fpv"), ("port", "station_fpv"))
        },
        "frames": None if recording.pictures is None else _frames(recording.pictures),
        "sky": _sky(recording) if recording.dated else None,
    }


def packed(values: Any) -> str:
    """An array as base64 of little-endian float32."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode("ascii")


def _asset(name: str) -> str:
    return (files("owm_envs.replay") / "assets" / name).read_text(encoding="utf-8").strip()


def _facts(recording: Recording) -> list[list[str]]:
    episode, last = recording.episode, {name: values[-1] for name, values in recording.columns.items()}
    outcome = episode.outcome_name
    kind = "docked" if outcome in _GOOD else "bad" if outcome in _BAD else "open"
    return [
        ["outcome", outcome.replace("_", " "), kind],
        ["port", PORTS[episode.port].name.replace("_", " ")],
        ["policy", recording.policy],
        ["duration", f"{recording.times[-1]:.1f} s"],
        ["\N{GREEK CAPITAL LETTER DELTA}v", f"{recording.delta_v:.2f} m/s"],
        ["least clearance", f"{recording.clearance:.2f} m", "bad" if recording.clearance <= 0 else ""],
        ["at the end", f"{last['distance']:.2f} m, {last['speed']:.3f} m/s, {last['attitude']:.1f}\N{DEGREE SIGN}"],
    ]


def _part(part: Part) -> dict[str, Any]:
    names = ("name", "primitive", "position", "axis", "side", "dimensions", "material")
    return {name: getattr(part, name) for name in names}


def _lens(lens: Any) -> dict[str, Any]:
    """A camera as the page takes it: where it is on its mount, and its field of view [deg]."""
    position, attitude = (np.asarray(value, float).tolist() for value in (lens.position, lens.attitude))
    return {
        "mount": lens.mount,
        "position": position,
        "attitude": attitude,
        "field": float(np.degrees(lens.field)),
    }


def _frames(pictures: Pictures) -> dict[str, Any]:
    # A data URI for each: any browser shows it at once, and seeking needs no decoder's help.
    images = [_jpeg(image, 90) for image in pictures.images]
    return {"rows": pictures.rows.tolist(), "images": images, "caption": pictures.caption}


def _sky(recording: Recording) -> dict[str, Any]:
    """Sun and Earth every so often, and the Earth's map."""
    from owm_envs.film import skies

    times = np.linspace(0, recording.times[-1], int(np.ceil(recording.times[-1] / _APART)) + 1)
    epoch = recording.episode.epoch[0]
    seen = skies(epoch + times[:, None] * np.array([0.0, 1.0]), recording.config)
    return {
        "times": packed(times),
        "sun": packed(seen.sun),
        "sunlight": packed(seen.sunlight),
        "earth_from_station": packed(seen.earth_from_station),
        "distance": float(np.linalg.norm(seen.earth[0])) / 1e3,
        "map": _jpeg(_earth(), 75),
    }


def _earth() -> np.ndarray:
    """The camera's map of the Earth, clouds over it, at a size for a page."""
    import cv2

    folder = files("owm_envs.camera") / "assets"
    kept = (np.frombuffer((folder / name).read_bytes(), np.uint8) for name in ("earth.jpg", "clouds.jpg"))
    maps = (cv2.imdecode(data, mode) for data, mode in zip(kept, (cv2.IMREAD_COLOR, cv2.IMREAD_GRAYSCALE)))
    ground, clouds = (cv2.resize(image, _EARTH, interpolation=cv2.INTER_AREA) for image in maps)
    cover = clouds[..., None] / 255.0
    return np.uint8(ground[..., ::-1] * (1 - cover) + 235 * cover)


def _jpeg(image: np.ndarray, quality: int) -> str:
    """An image as a data URI."""
    import cv2

    data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return "data:image/jpeg;base64," + base64.b64encode(data.tobytes()).decode("ascii")
