"""Small LeRobot datasets as others write them, in versions 2.1 and 3, for the tests."""

import json
from pathlib import Path

import av
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

CAMERA = "observation.images.cam"
FPS = 10
HEIGHT, WIDTH = 32, 48


def flat_frames(rows: int, first: int = 0) -> np.ndarray:
    """Frames (rows, H, W, 3) of one grey each, by which a frame is known: 5 levels from one to the next."""
    grey = (5 * (first + np.arange(rows)) % 250).astype(np.uint8)
    return np.broadcast_to(grey[:, None, None, None], (rows, HEIGHT, WIDTH, 3)).copy()


def save_video(path: Path, frames: np.ndarray, fps: float, options: dict[str, str] | None = None) -> None:
    """An H.264 file of these frames; without B-frames, a key frame each ten, unless options say otherwise."""
    path.parent.mkdir(parents=True, exist_ok=True)
    options = options or {"bf": "0", "g": "10", "keyint_min": "10", "sc_threshold": "0", "crf": "8"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=round(fps), options=options)
        stream.height, stream.width, stream.pix_fmt = *frames.shape[1:3], "yuv420p"
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")))
        container.mux(stream.encode())


def columns(number: int, rows: int, before: int) -> dict[str, np.ndarray]:
    """The rows of an episode."""
    rng = np.random.default_rng(number)
    return {
        "observation.state": rng.normal(size=(rows, 4)).astype(np.float32),
        "action": rng.normal(size=(rows, 2)).astype(np.float32),
        "timestamp": (np.arange(rows) / FPS).astype(np.float32),
        "frame_index": np.arange(rows),
        "episode_index": np.full(rows, number),
        "index": before + np.arange(rows),
        "task_index": np.zeros(rows, np.int64),
    }


def _table(rows: dict[str, np.ndarray]) -> pa.Table:
    return pa.table({name: pa.array(list(values)) if values.ndim > 1 else values for name, values in rows.items()})


def _info(folder: Path, version: str, lengths: list[int], **more: object) -> None:
    features = {
        name: {"dtype": values.dtype.name, "shape": list(values.shape[1:]) or [1], "names": None}
        for name, values in columns(0, 2, 0).items()
    }
    features[CAMERA] = {"dtype": "video", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]}
    info = {"codebase_version": version, "robot_type": "arm", "fps": FPS, "features": features, "chunks_size": 1000}
    info |= {"total_episodes": len(lengths), "total_frames": sum(lengths)} | more
    (folder / "meta").mkdir(parents=True, exist_ok=True)
    (folder / "meta" / "info.json").write_text(json.dumps(info))


def write_v2(folder: Path, lengths: list[int]) -> Path:
    """A dataset of version 2.1: a file an episode."""
    data = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
    video = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"
    _info(folder, "v2.1", lengths, data_path=data, video_path=video)
    (folder / "data/chunk-000").mkdir(parents=True)
    lines, stats, before = [], [], 0
    for number, rows in enumerate(lengths):
        told = columns(number, rows, before)
        pq.write_table(_table(told), folder / f"data/chunk-000/episode_{number:06d}.parquet")
        frames = flat_frames(rows, before)
        # Others' files have B-frames.
        save_video(folder / f"videos/chunk-000/{CAMERA}/episode_{number:06d}.mp4", frames, FPS, {"crf": "8"})
        lines.append({"episode_index": number, "tasks": ["Put it there."], "length": rows})
        action = told["action"]
        moments = {"mean": action.mean(0), "std": action.std(0), "min": action.min(0), "max": action.max(0)}
        moments = {key: value.tolist() for key, value in moments.items()} | {"count": [rows]}
        stats.append({"episode_index": number, "stats": {"action": moments}})
        before += rows
    for name, told in (("episodes", lines), ("episodes_stats", stats)):
        (folder / f"meta/{name}.jsonl").write_text("".join(json.dumps(line) + "\n" for line in told))
    return folder


def write_v3(folder: Path, lengths: list[int], group: int = 1000) -> Path:
    """A dataset of version 3: several episodes a file, and a row group of any number of rows."""
    data = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    _info(
        folder, "v3.0", lengths, data_path=data, video_path="videos/{video_key}/" + data[5:].replace("parquet", "mp4")
    )
    ends = np.cumsum(lengths)
    starts = ends - lengths
    parts = [_table(columns(number, rows, start)) for number, (rows, start) in enumerate(zip(lengths, starts))]
    (folder / "data/chunk-000").mkdir(parents=True)
    pq.write_table(pa.concat_tables(parts), folder / "data/chunk-000/file-000.parquet", row_group_size=group)
    save_video(folder / f"videos/{CAMERA}/chunk-000/file-000.mp4", flat_frames(sum(lengths)), FPS)
    place = {f"videos/{CAMERA}/{name}": [0] * len(lengths) for name in ("chunk_index", "file_index")}
    place |= {
        f"videos/{CAMERA}/from_timestamp": starts / FPS,
        f"videos/{CAMERA}/to_timestamp": np.cumsum(lengths) / FPS,
    }
    table = {
        "episode_index": np.arange(len(lengths)),
        "tasks": [["Put it there."]] * len(lengths),
        "length": lengths,
        "data/chunk_index": [0] * len(lengths),
        "data/file_index": [0] * len(lengths),
        "dataset_from_index": starts,
        "dataset_to_index": ends,
    }
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    pq.write_table(pa.table(table | place), folder / "meta/episodes/chunk-000/file-000.parquet")
    return folder


VIEW = "observation.images.fpv"


def add_video(folder: Path) -> Path:
    """Give a docking dataset of vectors a video, as the camera's part `pixels` becomes one; return the file."""
    path = folder / "meta/info.json"
    info = json.loads(path.read_text())
    info["features"][VIEW] = {"dtype": "video", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]}
    info["video_path"] = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
    path.write_text(json.dumps(info))
    path = folder / "meta/episodes/chunk-000/file-000.parquet"
    table, fps = pq.read_table(path), info["fps"]
    first, last = (table[f"dataset_{end}_index"].to_numpy() for end in ("from", "to"))
    more = {
        "chunk_index": first * 0,
        "file_index": first * 0,
        "from_timestamp": first / fps,
        "to_timestamp": last / fps,
    }
    for name, values in more.items():
        table = table.append_column(f"videos/{VIEW}/{name}", pa.array(values))
    pq.write_table(table, path, write_page_checksum=True)
    frames = flat_frames(info["total_frames"])
    stats = json.loads((folder / "meta/stats.json").read_text())
    stats[VIEW] = {name: np.full((3, 1, 1), getattr(frames / 255, name)()).tolist() for name in ("mean", "std")}
    (folder / "meta/stats.json").write_text(json.dumps(stats))
    video = folder / f"videos/{VIEW}/chunk-000/file-000.mp4"
    save_video(video, frames, fps)
    return video
