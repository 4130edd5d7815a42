"""Frames into MP4 files, through PyAV: equal frames give equal bytes.

H.264 (libx264) without B-frames, so that a frame is found by its number. On one thread, as bytes depend on how many
there are; without looking ahead, as x264's macroblock tree gave other bytes in 5 of 1000 runs of frames below 64x64.
"""

import os
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from owm_envs.files import write_atomically
from owm_envs.words import install

CODEC, QUALITY, KEY_FRAMES = "h264", 12, 10
"""As files name it; the constant rate factor of x264, lower is better; frames from one key frame to the next."""
_OPTIONS = {"preset": "veryfast", "bf": "0", "threads": "1", "sc_threshold": "0", "mbtree": "0", "rc-lookahead": "0"}


def require_av() -> Any:
    """PyAV.

    Raises:
        ImportError: it is not installed, with what to do.
    """
    try:
        import av
    except ImportError as error:
        raise ImportError(f"films need PyAV ({error}): {install('video')}") from error
    return av


def pixel_format(height: int, width: int) -> str:
    """How colours are kept: for each two by two pixels, as every player reads it; for each where a side is odd."""
    return "yuv444p" if height % 2 or width % 2 else "yuv420p"


class VideoWriter:
    """Write frames to an MP4 one by one; the file is good once closed.

    Args:
        file: path, or a binary file to write to.
        fps: frames a second.
        quality: constant rate factor, 0 to 51; lower is better.
    """

    def __init__(self, file: Any, fps: float, *, quality: int = QUALITY):
        self._av = require_av()
        self._container = self._av.open(os.fspath(file) if isinstance(file, os.PathLike) else file, "w", format="mp4")
        self._fps = Fraction(fps).limit_denominator(1001)
        self._options = {**_OPTIONS, "crf": str(quality), "g": str(KEY_FRAMES), "keyint_min": str(KEY_FRAMES)}
        self._stream: Any = None
        self.frames = 0

    def write(self, image: UInt8[np.ndarray, "H W 3"]) -> None:
        """Append a frame; all are of one size."""
        if self._stream is None:
            height, width = image.shape[:2]
            self._stream = self._container.add_stream("libx264", rate=self._fps, options=self._options)
            self._stream.height, self._stream.width = height, width
            self._stream.pix_fmt = pixel_format(height, width)
        frame = self._av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="rgb24")
        self._container.mux(self._stream.encode(frame))
        self.frames += 1

    def close(self) -> None:
        """Write what is left; nothing may follow."""
        if self._stream is not None:
            self._container.mux(self._stream.encode())
        self._container.close()


def join_videos(parts: Sequence[str | os.PathLike], file: Any, fps: float) -> None:
    """Put videos of one size and rate, as `VideoWriter` makes them, one behind another, without encoding anew.

    Args:
        file: path, or a binary file to write to.
        fps: frames a second.
    """
    av = require_av()
    period = 1 / Fraction(fps).limit_denominator(1001)
    with av.open(os.fspath(file) if isinstance(file, os.PathLike) else file, "w", format="mp4") as joined:
        stream, count = None, 0
        for part in parts:
            with av.open(os.fspath(part)) as source:
                given = source.streams.video[0]
                if stream is None:
                    stream = joined.add_stream_from_template(given)
                    stream.time_base = given.time_base
                for packet in source.demux(given):
                    if packet.dts is None:
                        continue
                    packet.pts = packet.dts = round(count * period / packet.time_base)
                    packet.stream = stream
                    joined.mux(packet)
                    count += 1


def save_film(path: str | os.PathLike, images: Iterable[UInt8[np.ndarray, "H W 3"]], fps: float) -> None:
    """Write pictures as an MP4 that any player shows, complete or not at all.

    Raises:
        ImportError: PyAV is not installed.
        ValueError: the name does not end in .mp4.
    """
    path = mp4(path)
    require_av()

    def write(file: Any) -> None:
        writer = VideoWriter(file, round(fps), quality=18)
        for image in images:
            writer.write(np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)), "edge"))
        writer.close()

    write_atomically(path, write)


def mp4(path: str | os.PathLike) -> Path:
    """The path of a film.

    Raises:
        ValueError: its name does not end in .mp4.
    """
    path = Path(path)
    if path.suffix.lower() != ".mp4":
        raise ValueError(f"a film's name must end in .mp4, got {path}")
    return path
