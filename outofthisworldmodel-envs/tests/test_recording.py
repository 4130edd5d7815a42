"""Recording with frames: what is in the video, and what a kill, a share or a second writer does to it."""

import json
import shutil
import subprocess
import sys
import tracemalloc

import av
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet as pq
import pytest
from seeing import CONFIG, REQUEST

from owm_envs.claims import Claim
from owm_envs.datasets.generate import Shard, generate, settings_of
from owm_envs.datasets.merge import merge
from owm_envs.datasets.recipe import Request, flights, splits
from owm_envs.datasets.runs import GENERATION
from owm_envs.env import DockingEnv
from owm_envs.files import JOURNAL, FolderTaken
from owm_envs.policies import make_policy
from owm_envs.rollout import episodes, rollout
from owm_envs.video import VideoWriter, join_videos

VIDEO = "observation.images.fpv"


def decoded(path):
    with av.open(str(path)) as container:
        return [(frame.pts * frame.time_base, frame.to_ndarray(format="rgb24")) for frame in container.decode(video=0)]


def files(root):
    return {str(file.relative_to(root)): file.read_bytes() for file in root.rglob("*") if file.is_file()}


def assert_same_bytes(one, other):
    one, other = files(one), files(other)
    assert one.keys() == other.keys()
    assert sorted(name for name in one if one[name] != other[name]) == []


@pytest.mark.slow
def test_a_video_holds_the_frame_of_every_row(seeing_run):
    """As the pure environment shows them: a frame at every other decision, held between."""
    env = DockingEnv(CONFIG)
    planned = [next(flights(splits(REQUEST, CONFIG)[name])) for name in ("train", "val")]
    for fold, (name, flight) in enumerate(zip(("train", "val"), planned)):
        info = json.loads((seeing_run / name / "meta/info.json").read_text())
        video = decoded(seeing_run / name / info["video_path"].format(video_key=VIDEO, chunk_index=0, file_index=0))
        assert len(video) == info["total_frames"] and info["features"][VIDEO]["shape"] == [16, 16, 3]
        assert [float(time) for time, _ in video] == [row / 4 for row in range(len(video))]
        rows = pq.read_table(seeing_run / name / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
        for row in rows:
            start, end = (row[f"videos/{VIDEO}/{key}"] for key in ("from_timestamp", "to_timestamp"))
            assert (start * 4, end * 4) == (row["dataset_from_index"], row["dataset_to_index"])
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(np.uint32(5)), fold), 0)
        chunks = rollout(env, make_policy(flight.policy, env), jnp.stack([key] * 8), np.full(8, flight.port), chunk=8)
        seen = next(episodes(chunks)).observation["pixels"]
        shown = np.stack([image for _, image in video[: len(seen)]]).astype(float)
        assert 10 * np.log10(255**2 / ((shown - seen) ** 2).mean()) > 32
        np.testing.assert_array_equal(seen[1::2], seen[:-1:2])


@pytest.mark.slow
def test_statistics_of_the_frames_are_those_before_encoding(seeing_run):
    told = json.loads((seeing_run / "train/meta/stats.json").read_text())[VIDEO]
    frames = (
        np.stack([image for _, image in decoded(seeing_run / f"train/videos/{VIDEO}/chunk-000/file-000.mp4")]) / 255
    )
    assert np.shape(told["mean"]) == (3, 1, 1) and told["count"] == [len(frames)]
    np.testing.assert_allclose(np.ravel(told["mean"]), frames.mean(axis=(0, 1, 2)), atol=0.02)
    np.testing.assert_allclose(np.ravel(told["std"]), frames.std(axis=(0, 1, 2)), atol=0.03)


@pytest.mark.slow
def test_shares_make_the_same_bytes_as_one_run(seeing_run, tmp_path):
    shares = [tmp_path / f"share-{index}" for index in range(3)]
    for index, folder in enumerate(shares):
        generate(folder, CONFIG, REQUEST, shard=Shard(index, 3))
    merge(shares[::-1], tmp_path / "set")
    assert_same_bytes(seeing_run, tmp_path / "set")
    with pytest.raises(ValueError, match="shares are missing: 2/3"):
        merge([shares[0], shares[2]], tmp_path / "other")
    with pytest.raises(ValueError, match="holds 1/3 beside 1/3"):
        merge([shares[0], shares[0]], tmp_path / "other")
    with pytest.raises(ValueError, match="is no finished share: record it with --shard"):
        merge([seeing_run], tmp_path / "other")
    with pytest.raises(ValueError, match=r"is no share of a dataset: it has no generation\.json"):
        merge([tmp_path], tmp_path / "other")
    other = Request(**{**REQUEST.settings(), "seed": 6})
    (shares[1] / "generation.json").write_text(
        json.dumps(json.loads((shares[1] / "generation.json").read_text()) | {"request": other.settings()})
    )
    with pytest.raises(ValueError, match="is a share of another run"):
        merge(shares, tmp_path / "other")
    assert not (tmp_path / "other.partial").exists()


@pytest.mark.slow
def test_memory_does_not_grow_with_the_recording(seeing_run, tmp_path):
    def peak(episodes):
        request = Request(None, None, episodes=episodes, val_episodes=2, episodes_per_batch=8)
        tracemalloc.start()
        generate(tmp_path / f"{episodes}", CONFIG, request)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    few, many = peak(8), peak(40)
    assert many < few + 32 * 8_000, "of an episode no more than its statistics may be held"


@pytest.mark.parametrize("text", ["0/2", "3/2", "2", "a/b", "1/2/3", "-1/2"])
def test_a_share_that_cannot_be_is_refused(text):
    with pytest.raises(ValueError, match="shard must be like 2/4"):
        Shard.parse(text)


@pytest.mark.slow
def test_a_run_killed_while_it_encodes_goes_on_to_the_same_bytes(seeing_run, tmp_path):
    """Killed when the first episode is safe and others are not."""
    config, out = tmp_path / "config.toml", tmp_path / "set"
    config.write_text(CONFIG.to_toml(), encoding="utf-8")
    numbers = {"transitions": 60, "val-transitions": 8, "seed": 5, "episodes-per-batch": 8}
    command = [sys.executable, "-m", "owm_envs", "generate", "--out", str(out), "--config", str(config)]
    command += [word for name, value in numbers.items() for word in (f"--{name}", str(value))]
    first = tmp_path / "set.partial/pieces/train/000000.arrow"
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        while not first.is_file() and process.poll() is None:
            pass
        process.kill()
    assert first.is_file() and not out.exists()
    (tmp_path / "set.partial/pieces/train/000001.arrow").unlink(missing_ok=True)  # a film without its seal
    (tmp_path / "set.partial/pieces/train/000001.pixels.mp4").write_bytes(b"half a film")
    generate(out, CONFIG, REQUEST)
    assert_same_bytes(seeing_run, out)


class Killed(Exception):
    """Stands for a kill: nothing is cleared away after it but what a full disk leaves too."""


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A run that was killed when every episode was safe, and none of the files made."""

    def kill(message):
        if "files of the dataset" in message:
            raise Killed

    out = tmp_path_factory.mktemp("killed") / "set"
    with pytest.raises(Killed):
        generate(out, CONFIG, REQUEST, announce=kill)
    return out.with_name("set.partial")


@pytest.fixture
def unsealed(killed, tmp_path):
    """A copy of it to damage."""
    return shutil.copytree(killed, tmp_path / "set.partial")


@pytest.mark.slow
def test_episodes_that_were_damaged_are_recorded_again(seeing_run, unsealed):
    pieces = unsealed / "pieces/train"
    names = [path.stem for path in sorted(pieces.glob("*.arrow"))]
    (pieces / f"{names[0]}.arrow").write_bytes(b"")
    (pieces / f"{names[1]}.arrow").unlink()
    (pieces / f"{names[2]}.pixels.mp4").unlink()
    (pieces / f"{names[3]}.pixels.mp4").write_bytes(b"")
    rows = bytearray((pieces / f"{names[4]}.arrow").read_bytes())
    rows[len(rows) // 2] ^= 1
    (pieces / f"{names[4]}.arrow").write_bytes(rows)
    (pieces / f"{names[5]}.arrow").write_bytes(rows[: len(rows) // 2])
    generate(unsealed.with_name("set"), CONFIG, REQUEST)
    assert_same_bytes(seeing_run, unsealed.with_name("set"))


@pytest.mark.slow
@pytest.mark.parametrize("there", ["all", "nothing but the dataset", "no seal", "a file less", "a file of nothing"])
def test_a_run_killed_after_its_files_were_made_is_finished(seeing_run, unsealed, there):
    shutil.copytree(seeing_run, unsealed, dirs_exist_ok=True)
    if there == "nothing but the dataset":
        shutil.rmtree(unsealed / "pieces")
    if there == "no seal":
        (unsealed / "manifest.json").unlink()
    if there == "a file less":
        (unsealed / "train/meta/stats.json").unlink()
    if there == "a file of nothing":
        (unsealed / "val/data/chunk-000/file-000.parquet").write_bytes(b"")
    generate(unsealed.with_name("set"), CONFIG, REQUEST)
    assert_same_bytes(seeing_run, unsealed.with_name("set"))
    assert not unsealed.exists()


@pytest.mark.slow
def test_a_run_killed_between_the_last_moves_is_finished(seeing_run, tmp_path, monkeypatch):
    """Into the current folder what was recorded moves one by one."""
    out, partial = tmp_path / "set", tmp_path / "set.partial"
    shutil.copytree(seeing_run, out)
    partial.mkdir()
    (partial / JOURNAL).write_text("\n".join(path.name for path in seeing_run.iterdir()))
    (out / "manifest.json").rename(partial / "manifest.json")
    monkeypatch.chdir(out)
    generate(".", CONFIG, REQUEST)
    assert_same_bytes(seeing_run, out)
    assert not partial.exists()


@pytest.mark.slow
def test_a_finished_run_that_was_damaged_is_not_taken_for_complete(seeing_run, tmp_path):
    out = shutil.copytree(seeing_run, tmp_path / "set")
    (out / "train/data/chunk-000/file-000.parquet").write_bytes(b"")
    with pytest.raises(ValueError, match=r"has 0 bytes, .*; remove .*set, and the same command records it anew"):
        generate(out, CONFIG, REQUEST)


def test_a_marker_that_was_damaged_is_told_with_what_to_do(tmp_path):
    Claim(tmp_path / "set.partial", settings_of(CONFIG, REQUEST), GENERATION).note()
    (tmp_path / "set.partial" / GENERATION).write_bytes(b"")
    with pytest.raises(
        FolderTaken, match=r"set\.partial holds a run whose generation\.json is damaged: .*or remove it"
    ):
        generate(tmp_path / "set", CONFIG, REQUEST)


def test_a_second_writer_is_refused(tmp_path):
    with (
        Claim(tmp_path / "set.partial", settings_of(CONFIG, REQUEST), GENERATION) as first,
        pytest.raises(FolderTaken, match=r"another process is at work in .*set\.partial"),
    ):
        first.note()
        generate(tmp_path / "set", CONFIG, REQUEST)


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 8 MB."""
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(place)]
    if not shutil.which("mount") or subprocess.run(command, capture_output=True).returncode:
        pytest.skip("needs the right to mount a file system")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)  # films that were broken off may still be open


@pytest.mark.slow
@pytest.mark.parametrize("left", [0, 8192, 65536])
def test_a_full_disk_is_told_and_the_run_goes_on_once_there_is_room(seeing_run, small_disk, left):
    """Whichever file is the one that does not fit."""
    filler = small_disk / "filler"

    def fill(progress):
        if not filler.exists():
            filler.write_bytes(bytes(shutil.disk_usage(small_disk).free - left))

    with pytest.raises(OSError, match="the disk is full; free some space and run the same again"):
        generate(small_disk / "set", CONFIG, REQUEST, progress=fill)
    filler.unlink()
    generate(small_disk / "set", CONFIG, REQUEST)
    assert_same_bytes(seeing_run, small_disk / "set")


@pytest.mark.parametrize("side", [16, 15])
def test_joined_videos_hold_the_frames_of_their_parts(tmp_path, side):
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (7, side, side, 3), dtype=np.uint8)
    for name, some in (("a", images[:4]), ("b", images[4:5]), ("c", images[5:])):
        writer = VideoWriter(tmp_path / f"{name}.mp4", 20)
        for image in some:
            writer.write(image)
        writer.close()
    join_videos([tmp_path / f"{name}.mp4" for name in "abc"], tmp_path / "all.mp4", 20)
    apart = [image for name in "abc" for _, image in decoded(tmp_path / f"{name}.mp4")]
    joined = decoded(tmp_path / "all.mp4")
    assert [float(time) for time, _ in joined] == [row / 20 for row in range(7)]
    np.testing.assert_array_equal([image for _, image in joined], apart)
