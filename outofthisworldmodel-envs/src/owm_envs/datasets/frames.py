"""Frames of an episode in a video: an array that is decoded where it is looked at."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import UInt8

from owm_envs.datasets.cache import Cache
from owm_envs.video import require_av


class Clip(NamedTuple):
    """Where the frames of an episode lie in a video."""

    path: Path
    start: float
    """Seconds from the video's beginning to the first frame."""
    count: int
    fps: float


class Frames:
    """The frames of a clip, (T, H, W, 3) uint8: an index or a slice decodes what it needs, `np.asarray` all.

    Args:
        clip: where they are.
        size: rows and columns of a frame.
        cache: of decoded frames, shared by a dataset.
    """

    dtype = np.dtype(np.uint8)
    ndim = 4

    def __init__(self, clip: Clip, size: tuple[int, int], cache: Cache):
        self.clip = clip
        self.shape = (clip.count, *size, 3)
        self._cache = cache

    def __repr__(self) -> str:
        return f"Frames({self.clip.path.name}, shape={self.shape})"

    def __len__(self) -> int:
        return self.clip.count

    def __iter__(self) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
        return (self[number] for number in range(len(self)))

    def __getitem__(self, rows: int | slice | Sequence[int] | np.ndarray) -> UInt8[np.ndarray, "... H W 3"]:
        """A frame, or several.

        Raises:
            IndexError: there is no such frame.
            ValueError: the video is damaged.
            ImportError: PyAV is not installed.
        """
        chosen = np.arange(len(self))[rows]
        frames = self._decoded(np.unique(chosen))
        if np.ndim(chosen) == 0:
            return frames[int(chosen)]
        images = np.empty((len(chosen), *self.shape[1:]), self.dtype)
        for place, number in enumerate(chosen.tolist()):
            images[place] = frames[number]
        return images

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        if copy is False:
            raise ValueError("frames of a video are decoded: there is no array to share")
        return self[:].astype(dtype or self.dtype, copy=False)

    def _decoded(self, numbers: Iterable[int]) -> dict[int, np.ndarray]:
        """Frames by their numbers; what is decoded on the way to them is kept too."""
        numbers = [int(number) for number in numbers]
        found = {number: self._cache.get((self.clip.path, self._in_file(number))) for number in numbers}
        missing = [number for number in numbers if found[number] is None]
        if missing:
            wanted = {self._in_file(number): number for number in missing}
            for place, image in decode(self.clip.path, self.clip.fps, min(wanted), max(wanted)):
                if image.shape != self.shape[1:]:
                    raise ValueError(
                        f"{self.clip.path}: frames are {image.shape}, info.json tells of {tuple(self.shape[1:])}"
                    )
                self._cache.put((self.clip.path, place), image, image.nbytes)
                if place in wanted:
                    found[wanted.pop(place)] = image
            if wanted:
                raise ValueError(f"{self.clip.path}: frame {min(wanted)} cannot be decoded: damaged, or too short")
        return found

    def _in_file(self, number: int) -> int:
        return round(self.clip.start * self.clip.fps) + number


def decode(path: Path, fps: float, first: int, last: int) -> Iterator[tuple[int, UInt8[np.ndarray, "H W 3"]]]:
    """Decode a video from the key frame before `first` to `last`: the frames with their numbers, in order.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is damaged.
        ImportError: PyAV is not installed.
    """
    av = require_av()
    try:
        with av.open(str(path)) as video:
            stream = video.streams.video[0]
            if first > 0:
                video.seek(int(first / fps / stream.time_base), stream=stream)
            for frame in video.decode(stream):
                if frame.is_corrupt:
                    raise ValueError(f"{path}: a frame is damaged")
                number = round(float(frame.pts * frame.time_base) * fps)
                yield number, frame.to_ndarray(format="rgb24")
                if number >= last:
                    return
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} is missing") from None
    except (av.FFmpegError, ArithmeticError, IndexError, TypeError, MemoryError) as error:
        raise ValueError(f"{path} cannot be decoded: {' '.join(str(error).split())}") from None
