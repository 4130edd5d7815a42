"""Damage checkpoints of every kind in every way known, and see that each is refused in a line, or read as it says.

python tools/fuzz_checkpoints.py --flips 40
"""

import argparse
import collections
import json
import os
import random
import signal
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
import safetensors.numpy

from owm.baselines.constant_velocity import ConstantVelocity
from owm.baselines.least_squares import LeastSquares
from owm.baselines.ppo.features import FEATURES
from owm.baselines.ppo.policy import Observed, save_policy
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.hub import repository
from owm.catalogue.policies import kind_of, load_policy
from owm.checkpoint import FILES, HEADER, STATISTICS, WEIGHTS, CheckpointError, save_world_model, sealed
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS
from owm.model.world_model import LearnedWorldModel, Network, Params
from owm.motion.linear import LinearMap
from owm_envs.config import load_config
from owm_envs.env import DockingEnv

SECONDS = 20
"""Longest that a door may take."""
FLOWN = load_config(fidelity="iss-hcw", steps_per_action=5)
SMALL = {"width": 16, "heads": 2, "window": 3, "head_width": 8, "history_length": 4}
EXPECTED = (ValueError, OSError, ArithmeticError, ImportError)
"""What the commands tell in a line."""
ABSURD = [
    *(None, True, "", "8", "[/x]", "../../x", "\x00", "x" * 10**6, [], [8], {}, {"x": 8}),
    *(0, -1, 2.5, 10**9, 2**63, 10**400, 1e9, 5e-324, float("nan"), float("inf")),
]
"""Values for every field."""


def make(root: Path) -> dict[str, Path]:
    """Small checkpoints of every kind, with numbers that nobody trained."""
    rng = np.random.default_rng(0)

    def numbers(tree: Any) -> Any:
        return jax.tree.map(lambda leaf: rng.uniform(0.1, 1.0, leaf.shape).astype(np.float32), tree)

    linear = LinearMap.skeleton(np.float32)
    models: dict[str, Any] = {"constant_velocity": ConstantVelocity(), "least_squares": LeastSquares(numbers(linear))}
    for stream, backbone in (("kinematic", "transformer"), ("adaptive", "gru"), ("latent", "mlp"), ("plain", "mlp")):
        config = ModelConfig(stream=stream, backbone=backbone, **SMALL)
        network = eqx.filter_eval_shape(lambda config=config: Network(config, key=jax.random.key(0)))
        params = Params(numbers(network), numbers(STREAMS[stream].skeleton(np.float32)))
        models[stream] = LearnedWorldModel(config, params)
    corpus = {"name": "set", "fidelity": "iss", "noise": {"position": 0.05}}
    about = {"corpus": [corpus], "score": 0.5, "step": 10, "settled": {"seed": 0}, "run": {"config": {"seed": 0}}}
    folders = {name: save_world_model(model, root / name, about=about) for name, model in models.items()}
    names = list(DockingEnv(FLOWN).layout.names)
    widths = [len(names) + FEATURES, 4, 6]
    weights = {"mean": np.zeros(widths[0]), "variance": np.ones(widths[0])}
    for i in range(2):
        weights |= {f"weight.{i}": rng.uniform(size=(widths[i + 1], widths[i])), f"bias.{i}": np.zeros(widths[i + 1])}
    save_policy(root / "ppo", weights, Observed(env="iss-hcw", observe_field=True, observation=names), {"step": 1})
    return folders | {"ppo": root / "ppo"}


_FILES = {"config": HEADER, "weights": WEIGHTS, "statistics": STATISTICS}


class Hangs(BaseException):
    """A door took longer than `SECONDS`."""


class Damage(NamedTuple):
    """One way to damage a checkpoint."""

    name: str
    files: Callable[[], dict[str, bytes | None]]
    """Makes new contents; None for a file that is missing."""
    forged: bool
    """Whether the digests were made to fit, so that sensible numbers are another checkpoint's, and to be read."""


def plain(name: str, **files: bytes | None) -> Damage:
    """Damage to a file whose digest stays: `config`, `weights` or `statistics`."""
    return Damage(name, lambda: {_FILES[key]: data for key, data in files.items()}, forged=False)


def forged(name: str, header: dict[str, Any], **files: bytes | Callable[[], bytes]) -> Damage:
    """Damage whose digests fit: another header, other `weights` or `statistics`."""

    def make() -> dict[str, bytes | None]:
        made = {_FILES[key]: data if isinstance(data, bytes) else data() for key, data in files.items()}
        digests = {file: digest for file, digest in header["sha256"].items() if file != HEADER}
        digests |= {file: sha256(data).hexdigest() for file, data in made.items()}
        return {**made, HEADER: sealed(header | {"sha256": digests})}

    return Damage(name, make, forged=True)


def damages(folder: Path, flips: int = 4, seed: int = 0) -> Iterator[Damage]:
    """Every kind of damage to a checkpoint.

    Args:
        flips: bytes to change in each file, one at a time.
    """
    rng = random.Random(seed)
    contents = {name: (folder / name).read_bytes() for name in FILES}
    header = json.loads(contents[HEADER])
    for key, name in _FILES.items():
        data = contents[name]
        yield plain(f"{name} missing", **{key: None})
        yield plain(f"{name} empty", **{key: b""})
        yield plain(f"{name} cut", **{key: data[: len(data) // 2]})
        yield plain(f"{name} longer", **{key: data + b" "})
        for place in rng.choices(range(len(data)), k=flips):
            flipped = bytearray(data)
            flipped[place] ^= 1 << rng.randrange(8)
            yield plain(f"{name} byte {place}", **{key: bytes(flipped)})
            if name != HEADER:
                yield forged(f"{name} byte {place}, forged", header, **{key: bytes(flipped)})
    yield from _headers(header)
    yield from _statistics(header, json.loads(contents[STATISTICS]))
    yield from _tensors(header, contents[WEIGHTS])
    yield from _formats(header, contents[WEIGHTS])


def _places(table: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths to every field, and into the first of a list."""
    inside = table.items() if isinstance(table, dict) else enumerate(table[:1]) if isinstance(table, list) else ()
    for key, value in inside:
        yield (*path, key)
        yield from _places(value, (*path, key))


def _with(table: Any, path: tuple, value: Any) -> Any:
    """A copy of a table with another value at a path."""
    copy = dict(table) if isinstance(table, dict) else list(table)
    copy[path[0]] = _with(table[path[0]], path[1:], value) if path[1:] else value
    return copy


def _headers(header: dict[str, Any]) -> Iterator[Damage]:
    for place in _places(header):
        name = ".".join(map(str, place))
        if place[0] == "sha256":
            yield plain(name, config=json.dumps(_with(header, place, 3)).encode())
            continue
        for value in ABSURD:
            yield forged(f"{name} = {_few(value)}", _with(header, place, value))
        yield plain(f"{name} edited", config=json.dumps(_with(header, place, 7), indent=1).encode())
        if len(place) == 1:
            yield forged(f"no {name}", {key: value for key, value in header.items() if key != name})
    for text in (b"[" * 10**5, b'{"config":' * 10**5, b"[1]", b"3", b"\xff", b"NaN", b'{"format": 3}'):
        yield plain(f"config.json is {text[:12]!r}", config=text)
    deep: Any = 0
    for _ in range(900):
        deep = [deep]
    yield forged("deep about", header | {"about": {"deep": deep}})


def _few(value: Any) -> str:
    return json.dumps(value)[:20]


def _statistics(header: dict[str, Any], table: dict[str, Any]) -> Iterator[Damage]:
    wrong = [*ABSURD, [[1], [1, 2]], ["1j"], [1e38] * 6, [float("nan")] * 6, [-1.0] * 6, [0.0] * 6]
    for name, value in table.items() or [("unknown", 0)]:
        first = np.full(np.shape(value), 1.0)
        for bad in (*wrong, *(first * x for x in (np.nan, np.inf, 1e38, -1.0, 0.0, 1e-40))):
            bad = bad.tolist() if isinstance(bad, np.ndarray) else bad
            other = table | {name: bad}
            yield forged(f"{name} = {_few(bad)}", header, statistics=lambda other=other: json.dumps(other).encode())
    for text in (b"[1, 2]", b"null", b"", b"[" * 10**5, b'{"a":' * 10**5):
        yield forged(f"statistics are {text[:12]!r}", header, statistics=text)


def _tensors(header: dict[str, Any], data: bytes) -> Iterator[Damage]:
    tensors = safetensors.numpy.load(data)
    more = tensors | {"surplus": np.ones(1, np.float32)}
    yield forged("no tensors", header, weights=safetensors.numpy.save({}))
    yield forged("a tensor more", header, weights=safetensors.numpy.save(more))
    bad: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
        *((f"* {x:g}", lambda w, x=x: w * np.float32(x)) for x in (np.nan, np.inf, 1e38, 1e10)),
        *((kind, lambda w, kind=kind: w.astype(kind)) for kind in ("complex64", "int32", "float64", "float16", "bool")),
        ("one nan", lambda w: np.where(np.arange(w.size).reshape(w.shape) == 0, np.float32(np.nan), w)),
        ("flat", lambda w: w.reshape(-1)[: w.size - 1].copy()),
        ("empty", lambda w: w.reshape(-1)[:0].copy()),
    ]
    for name, tensor in tensors.items():

        def changed(change: Callable, name: str = name, tensor: np.ndarray = tensor) -> bytes:
            with np.errstate(all="ignore"):
                return safetensors.numpy.save(tensors | {name: np.ascontiguousarray(change(tensor + 0.5))})

        for what, change in bad:
            yield forged(f"{name} {what}", header, weights=partial(changed, change))
        rest = {other: value for other, value in tensors.items() if other != name}
        yield forged(f"no {name}", header, weights=partial(safetensors.numpy.save, rest))


def _formats(header: dict[str, Any], data: bytes) -> Iterator[Damage]:
    """Headers of safetensors that don't tell the truth."""
    size = int.from_bytes(data[:8], "little")
    table, rest = json.loads(data[8 : 8 + size]), data[8 + size :]

    def packed(table: Any) -> bytes:
        text = table if isinstance(table, bytes) else json.dumps(table).encode()
        return len(text).to_bytes(8, "little") + text + rest

    for text in (b"", b"[]", b"null", b"[" * 10**5, b'{"a":' * 10**5):
        yield forged(f"tensors' header is {text[:12]!r}", header, weights=packed(text))
    for length in (0, 2**31, 2**63, 2**64 - 1):
        yield forged(f"header of {length} bytes", header, weights=length.to_bytes(8, "little") + data[8:])
    for name in list(table)[:2]:
        for field in ("shape", "dtype", "data_offsets"):
            for value in (*ABSURD, [10**9] * 4, [-1], [2**63, 2], "C64", "BF16", "F8_E4M3", [0, 2**62], [4, 0]):
                other = _with(table, (name, field), value)
                yield forged(f"{name}.{field} = {_few(value)}", header, weights=partial(packed, other))


def lay(folder: Path, whole: Path, damage: Damage) -> None:
    """Write a damaged copy of a whole checkpoint."""
    folder.mkdir()
    files = damage.files()
    for name in FILES:
        data = files[name] if name in files else (whole / name).read_bytes()
        if data is not None:
            (folder / name).write_bytes(data)


def judge(folder: Path, damage: Damage) -> str:
    """Try every door; return "refused" or "read", of a forged one that is what it says.

    Raises:
        AssertionError: it was read though its digests are wrong, or not as it says.
        Exception: of a door, which the commands would not tell in a line.
    """
    for door in (kind_of, lambda path: repository(path, "user/name")):
        try:
            door(str(folder))
        except EXPECTED as error:
            assert str(error) and len(str(error)) < 2000, "no words, or too many"
    try:
        if (folder / HEADER).exists() and b'"kind": "ppo"' in (folder / HEADER).read_bytes():
            load_policy(str(folder), FLOWN, field=())
            read = None
        else:
            read = load_world_model(folder)
    except EXPECTED as error:
        assert isinstance(error, CheckpointError) or "the policy observes" in str(error), repr(error)
        assert len(str(error)) < 1000, "too many words"
        return "refused"
    assert damage.forged, "read, though its digests are wrong"
    if read is not None:
        said = json.loads((folder / HEADER).read_bytes())
        assert {**read.contents().config} == {**read.contents().config, **said["config"]}, (
            "not the configuration it tells"
        )
        assert read.name == said.get("name", ""), "not the name it tells"
        tensors = safetensors.numpy.load((folder / WEIGHTS).read_bytes())
        leaves = jax.tree.leaves(read.contents().weights)
        assert sum(leaf.size for leaf in leaves) == sum(part.size for part in tensors.values())
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(read.params)), "numbers that are not finite"
    return "read"


def _hangs(*_: Any) -> None:
    raise Hangs(f"more than {SECONDS} s")


def main() -> None:
    """Print what came of how many, and everything that was read or went wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--flips", type=int, default=8, help="changed bytes in each file")
    parser.add_argument("--every", type=int, default=1, help="try one of so many")
    options = parser.parse_args()
    signal.signal(signal.SIGALRM, _hangs)
    counts: collections.Counter = collections.Counter()
    slowest = 0.0
    with tempfile.TemporaryDirectory() as root:
        for kind, whole in make(Path(root)).items():
            for number, damage in enumerate(damages(whole, options.flips)):
                if number % options.every:
                    continue
                folder = Path(root, f"{kind}-{number}")
                lay(folder, whole, damage)
                signal.alarm(SECONDS)
                began = time.perf_counter()
                try:
                    outcome = judge(folder, damage)
                except (Exception, Hangs) as error:
                    outcome = "WRONG"
                    print(f"{kind}: {damage.name}: {type(error).__name__}: {str(error)[:200]}", flush=True)
                signal.alarm(0)
                slowest = max(slowest, time.perf_counter() - began)
                counts[kind, outcome] += 1
                if outcome == "read":
                    print(f"{kind}: {damage.name}: read", flush=True)
                for file in folder.iterdir():
                    os.unlink(file)
                folder.rmdir()
    for (kind, outcome), count in sorted(counts.items()):
        print(f"{kind:18} {outcome:8} {count:6}")
    print(f"slowest {slowest:.1f} s")
    raise SystemExit(any(outcome == "WRONG" for _, outcome in counts))


if __name__ == "__main__":
    main()
