"""Checkpoints of every kind that were damaged, forged or made to hurt: refused in a line, or read as they say."""

import json
import os
from dataclasses import replace

import fuzz_checkpoints
import jax
import numpy as np
import pytest
import safetensors.numpy
from fuzz_checkpoints import damages, forged, judge, lay, plain

from owm.baselines.ppo.policy import Observed, save_policy
from owm.catalogue.checkpoint import load_world_model
from owm.catalogue.hub import repository
from owm.catalogue.kinds import check
from owm.catalogue.policies import content_digest, kind_of, load_policy
from owm.checkpoint import (
    HEADER,
    STATISTICS,
    WEIGHTS,
    CheckpointError,
    read_header,
    save_world_model,
    sealed,
)
from owm.model.config import ModelConfig
from owm.model.streams import STREAMS

KINDS = {
    "constant_velocity": 41,
    "least_squares": 59,
    "kinematic": 367,
    "adaptive": 353,
    "latent": 349,
    "plain": 331,
    "ppo": 47,
}
"""Every so many of the campaign's cases are tried here; `tools/fuzz_checkpoints.py` tries them all."""

OBSERVED = Observed(env="iss", observe_field=False, observation=["x", "y"])
LAYER = {"weight.0": np.zeros((6, 2)), "bias.0": np.zeros(6)}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return fuzz_checkpoints.make(tmp_path_factory.mktemp("whole"))


@pytest.fixture
def change(whole, tmp_path):
    """Write a kind's checkpoint with other files, whose digests fit, or with another header."""

    def write(kind="kinematic", header=(), **files):
        said = json.loads((whole[kind] / HEADER).read_text())
        folder = tmp_path / f"changed-{len(os.listdir(tmp_path))}"
        lay(folder, whole[kind], forged("", said | dict(header), **files))
        return folder

    return write


@pytest.mark.parametrize("kind", KINDS)
def test_a_sample_of_the_campaign(kind, whole, tmp_path):
    found = set()
    for number, damage in enumerate(damages(whole[kind])):
        if number % KINDS[kind] == 0:
            lay(folder := tmp_path / str(number), whole[kind], damage)
            found.add(judge(folder, damage))
    assert "refused" in found


@pytest.mark.parametrize("kind", ["least_squares", "latent"])
@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e38])
def test_numbers_that_mean_nothing_are_not_written(kind, bad, whole, tmp_path):
    model = load_world_model(whole[kind])
    broken = replace(model, params=jax.tree.map(lambda leaf: np.asarray(leaf) * np.float32(bad), model.params))
    with pytest.raises(CheckpointError, match=r"numbers that are not (finite|between)"):
        save_world_model(broken, tmp_path / "broken")
    with pytest.raises(CheckpointError, match=r"mean holds .* numbers that are not"):
        save_policy(tmp_path / "broken", {"mean": np.full(2, bad), "variance": np.ones(2), **LAYER}, OBSERVED, {})
    assert not (tmp_path / "broken").exists()


def test_missing_damaged_and_other_files_are_named(whole, tmp_path):
    with pytest.raises(CheckpointError, match=r"config\.json is missing"):
        load_world_model(tmp_path)
    for name, told in (("weights", "is damaged"), ("statistics", r"does not match config\.json")):
        file = {"weights": WEIGHTS, "statistics": STATISTICS}[name]
        data = (whole["latent"] / file).read_bytes()
        lay(tmp_path / name, whole["latent"], plain("", **{name: data[:-8]}))
        with pytest.raises(CheckpointError, match=f"{file} {told}"):
            load_world_model(tmp_path / name)
    other = tensors_with(whole["least_squares"], "bias", lambda bias: bias + 1)
    lay(tmp_path / "other", whole["least_squares"], plain("", weights=other))
    for door in (check, lambda path: content_digest(str(path))):
        with pytest.raises(CheckpointError, match=r"does not match config\.json: damaged, or from another checkpoint"):
            door(tmp_path / "other")


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ({"format": 99}, "has format 99, this version reads format 3"),
        ({"format": True}, "format: must be no truth value"),
        ({"kind": "dreamer"}, "unknown kind 'dreamer', expected learned, "),
        ({"kind": "least_squares", "config": {"history_length": 8, "dt": 0.25}}, "not part of this configuration"),
        ({"name": "a\nb"}, "name: "),
        ({"name": "x" * 201}, "name: "),
        ({"more": 1}, "unknown key 'more'"),
    ],
)
def test_mismatches_are_refused(header, told, change):
    folder = change(header=header)
    with pytest.raises(CheckpointError, match=f"{folder.name}.*{told}"):
        load_world_model(folder)


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_whole_is_read(kind, whole, tmp_path):
    same = forged("the same", json.loads((whole[kind] / HEADER).read_text()))
    lay(tmp_path / "same", whole[kind], same)
    assert (tmp_path / "same" / HEADER).read_bytes() == (whole[kind] / HEADER).read_bytes()
    assert judge(tmp_path / "same", same) == "read"
    assert content_digest(str(tmp_path / "same")) == content_digest(str(whole[kind]))


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        *((name, 10**9, rf"{name}.* must be at most") for name in ("blocks", "history_length", "window", "head_steps")),
        *((name, 10**9, rf"{name}.* must be at most") for name in ("width", "mlp_ratio", "head_blocks", "dt")),
        ("blocks", 64, "config has blocks=64, the weights 1"),
        ("head_blocks", 64, "config has head_blocks=64, the weights 1"),
        ("width", 4096, "expected float32"),
        ("width", 16.0, "width: must be a whole number"),
        ("width", "16", "width: must be a whole number"),
        ("heads", True, "heads: must be no truth value"),
        ("dt", float("nan"), "dt: must be"),
        ("dt", float("inf"), "dt: must be"),
        ("widht", 3, "unknown key 'widht'"),
        ("skip", "bilinear", "names fields twice"),
        pytest.param("history_length", 10**400, "must be less than 2", id="history_length-too-long-to-write"),
    ],
)
def test_sizes_and_types_are_bounded(field, value, told, change, whole):
    config = read_header(whole["kinematic"]).config
    folder = change(header={"config": config | {field: value}})
    with pytest.raises(CheckpointError, match=rf"{folder.name}.*({told})"):
        load_world_model(folder)


@pytest.mark.parametrize("kind", ["constant_velocity", "least_squares"])
@pytest.mark.parametrize("config", [{"history_length": 10**9}, {"dt": 1e9}, {"dt": "0.25"}, {"dt": -0.25}, {"more": 1}])
def test_simple_models_are_bounded_too(kind, config, change):
    with pytest.raises(CheckpointError, match=next(iter(config))):
        load_world_model(change(kind, {"config": {"history_length": 8, "dt": 0.25} | config}))
    with pytest.raises(CheckpointError, match=r"dt.*is missing"):
        load_world_model(change(kind, {"config": {"history_length": 8}}))


@pytest.mark.parametrize("backbone", ["gru", "mlp"])
def test_layers_of_other_backbones_are_bounded(backbone, change, whole):
    config = read_header(whole["kinematic"]).config | {"backbone": backbone, "blocks": 64}
    with pytest.raises(CheckpointError, match=r"config has blocks=64|missing"):
        load_world_model(change(header={"config": config}))


def tensors_with(folder, name, change):
    tensors = safetensors.numpy.load((folder / WEIGHTS).read_bytes())
    with np.errstate(all="ignore"):
        return safetensors.numpy.save(tensors | {name: change(tensors.get(name))})


@pytest.mark.parametrize(
    ("kind", "name", "damage", "told"),
    [
        ("kinematic", "head.out.weight", lambda w: w / 0, "head.out.weight holds .* not finite"),
        ("kinematic", "head.out.weight", lambda w: w * 1e38, "head.out.weight holds .* not between -1000 and 1000"),
        ("kinematic", "head.out.weight", lambda w: w * 1j, "head.out.weight must hold real numbers"),
        ("kinematic", "head.out.weight", lambda w: w[1:], "head.out.weight is float32"),
        ("kinematic", "more", lambda w: np.ones(1), "more not part of this configuration"),
        ("least_squares", "action", lambda w: w * 0 + 1e38, "action holds 36 of 36 .* not between -10 and 10"),
        ("least_squares", "bias", lambda w: w * 0 + np.nan, "bias holds 6 of 6 numbers that are not finite"),
        ("constant_velocity", "more", lambda w: np.ones(1), "more not part of this configuration"),
        ("ppo", "weight.0", lambda w: w * np.nan, "weight.0 holds .* not finite"),
        ("ppo", "weight.1", lambda w: w[:5], "weight.1 is"),
        ("ppo", "mean", lambda w: w + 1e38, "mean holds .* not between"),
        ("ppo", "variance", lambda w: -w, "variance holds .* not between 0 and"),
        ("ppo", "weight.7", lambda w: np.ones((6, 6)), "bias.2, .* missing"),
    ],
)
def test_weights_that_mean_nothing_are_refused(kind, name, damage, told, change, whole):
    weights = tensors_with(whole[kind], name, lambda w: np.asarray(damage(w)).astype(_type(damage(w))))
    folder = change(kind, weights=weights)
    with pytest.raises(CheckpointError, match=f"{folder.name}: {told}"):
        load_policy(str(folder), fuzz_checkpoints.FLOWN, field=()) if kind == "ppo" else load_world_model(folder)


def _type(array):
    return np.complex64 if np.iscomplexobj(array) else np.float32


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("linear.bias", [float("nan")] * 6, "linear.bias holds 6 of 6 numbers that are not finite"),
        ("linear.bias", [1e38] * 6, "linear.bias holds 6 of 6 numbers that are not between"),
        ("action_scale", [0.0] * 6, "action_scale holds 6 of 6 numbers that are not between 1e-10 and"),
        ("filter.noise", [-1.0] * 4, "filter.noise holds 4 of 4 numbers that are not between"),
        pytest.param("rate_scale", 10**400, "cannot be read: .*too large", id="rate_scale-too-long-to-write"),
        ("rate_scale", True, "rate_scale .* must hold real numbers"),
        ("linear.bias", ["1"] * 6, "linear.bias .* must hold real numbers"),
        ("linear.bias", ["1j"] * 6, "linear.bias .* must hold real numbers"),
        ("linear.bias", [[1], [1, 2]], "linear.bias .* must hold real numbers"),
        ("linear.bias", None, "linear.bias .* must hold real numbers"),
        ("linear.bias", [1.0], r"linear.bias is float32 \(1,\), expected float32 \(6,\)"),
        ("more", 1.0, "more not part"),
    ],
)
def test_statistics_that_mean_nothing_are_refused(name, value, told, change, whole):
    table = json.loads((whole["kinematic"] / STATISTICS).read_text())
    folder = change(statistics=json.dumps(table | {name: value}).encode())
    with pytest.raises(CheckpointError, match=f"{folder.name}:? {told}"):
        load_world_model(folder)


@pytest.mark.parametrize("name", ["weights", "statistics"])
@pytest.mark.parametrize("data", [b"", b"[1, 2]", b"[" * 10**5, b'{"a":' * 10**5, b"null", b"\xff" * 20])
def test_files_of_something_else_are_refused(name, data, change):
    folder = change(**{name: data})
    for door in (load_world_model, check):
        with pytest.raises(CheckpointError, match=folder.name) as error:
            door(folder)
        assert len(str(error.value)) < 600


@pytest.mark.parametrize(
    "text", [b"[" * 10**5, b"[1]", b'{"format": 3, "kind": "learned", "sha256": 3}', b"\xff", b"{", b"", b"x" * 2**25]
)
def test_a_damaged_header_is_named_at_every_door(text, whole, tmp_path):
    lay(tmp_path / "m", whole["kinematic"], plain("", config=text))
    doors = (load_world_model, read_header, check, lambda path: kind_of(str(path)))
    for door in (*doors, lambda path: content_digest(str(path)), lambda path: repository(path, "user/name")):
        with pytest.raises(CheckpointError, match=r"config\.json (is damaged|has 33,554,432 bytes)") as error:
            door(tmp_path / "m")
        assert len(str(error.value)) < 600


@pytest.mark.parametrize("kind", ["kinematic", "ppo"])
def test_every_byte_of_the_header_is_digested(kind, whole, tmp_path):
    data = (whole[kind] / HEADER).read_bytes()
    (tmp_path / "m").mkdir()
    for place in range(0, len(data), 7):
        (tmp_path / "m" / HEADER).write_bytes(data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :])
        with pytest.raises(CheckpointError):
            read_header(tmp_path / "m")
    (tmp_path / "m" / HEADER).write_bytes(data.replace(b'"score": 0.5', b'"score": 0.4').replace(b"hcw", b"HCW"))
    with pytest.raises(CheckpointError, match="does not match its own digest: it was damaged or edited"):
        read_header(tmp_path / "m")


def test_older_formats_are_read_without_that_digest(whole, tmp_path):
    for kind in ("kinematic", "ppo"):
        header = json.loads((whole[kind] / HEADER).read_text())
        digests = {name: digest for name, digest in header.pop("sha256").items() if name != HEADER}
        lay(folder := tmp_path / kind, whole[kind], plain(""))
        if kind == "ppo":
            older = {
                "format": 1,
                "kind": "ppo",
                "sha256": digests[WEIGHTS],
                "about": header["about"] | header["config"],
            }
            (folder / STATISTICS).unlink()
        else:
            older = header | {"format": 2, "sha256": digests}
        (folder / HEADER).write_text(json.dumps(older))
        assert judge(folder, forged("", header)) == "read"
        (folder / HEADER).write_text(json.dumps(header | {"sha256": digests}))
        with pytest.raises(CheckpointError, match=r"sha256 must be of config\.json, "):
            read_header(folder)


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ({"corpus": 3}, "corpus: must be a list"),
        ({"corpus": [{"noise": {"position": {"x": 1}}}]}, "position: must be a number"),
        ({"corpus": [{"name": ["set"]}]}, "name: must be text"),
        ({"settled": [1]}, "settled: must be a table"),
        ({"score": "good"}, "score: must be a number"),
        ({"step": 1.5}, "step: must be a whole number"),
    ],
)
def test_what_is_told_has_its_type(about, told, change):
    folder = change(header={"about": about})
    for door in (load_world_model, lambda path: repository(path, "user/name")):
        with pytest.raises(CheckpointError, match=told):
            door(folder)


@pytest.mark.skipif(os.name == "nt", reason="pipes and devices are POSIX's")
@pytest.mark.parametrize("make", [os.mkdir, os.mkfifo, lambda path: os.symlink("/dev/zero", path)])
def test_what_is_no_file_is_not_waited_for(make, whole, tmp_path):
    for key, name in (("config", HEADER), ("weights", WEIGHTS), ("statistics", STATISTICS)):
        lay(folder := tmp_path / name, whole["kinematic"], plain("", **{key: None}))
        make(folder / name)
        with pytest.raises(CheckpointError, match=f"{name} is missing"):
            load_world_model(folder)


def test_a_file_of_gigabytes_is_not_read(change):
    for name in (WEIGHTS, STATISTICS, HEADER):
        folder = change()
        os.truncate(folder / name, 2**36)
        for door in (load_world_model, check):
            with pytest.raises(CheckpointError, match=r"damaged|bytes, a checkpoint's at most"):
                door(folder)


def test_the_statistics_of_every_stream_are_within_what_is_read(whole):
    for stream, make in STREAMS.items():
        for leaf in make.skeleton(np.float32):
            assert getattr(leaf, "least", -1e3) < getattr(leaf, "most", 1e3), stream


def test_a_seal_is_that_of_the_text_without_it():
    text = sealed({"sha256": {}})
    assert sealed({"sha256": json.loads(text)["sha256"]}) == text
    assert ModelConfig(blocks=64, head_blocks=64).blocks == 64
