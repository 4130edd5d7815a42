"""Pixels as a part of the observation, through every adapter; frames of 16 by 16, every third decision."""

import pickle
import subprocess
import sys
from dataclasses import dataclass
from typing import ClassVar

import gymnasium
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from owm_envs.camera.sensor import CameraSensor
from owm_envs.config import load_config
from owm_envs.config.camera import CameraConfig, EffectsConfig
from owm_envs.config.parts import CameraRanges
from owm_envs.env import DockingEnv
from owm_envs.view import View

EVERY = 3
CONFIG = {"fidelity": "iss", "noise": "cooperative", "horizon": 0.35, "ports": ["zvezda_aft", "unity_nadir"]}
CAMERA = {"width": 16, "height": 16, "every": EVERY, "lamp": 20.0, "sky": False}
RANGES = {"camera": {"sun_scale": (0.5, 2.0), "tilt_deg": (0.0, 5.0), "albedo_scale": (0.5, 1.5)}}
SEEING = {"config": CONFIG, "observation": "state+pixels", "camera": CAMERA, "randomization": RANGES}
ACTIONS = np.random.default_rng(0).uniform(-500, 500, (7, 6)).astype(np.float32)


def make(**kwargs):
    return gymnasium.make("ISS-v0", **{**SEEING, **kwargs})


def flown(env, actions=ACTIONS, **reset):
    """Observations and infos of a flight."""
    seen, infos = zip(env.reset(**reset))
    seen, infos = list(seen), list(infos)
    for action in actions:
        observation, _, _, _, info = env.step(action)
        seen.append(observation)
        infos.append(info)
    return seen, infos


@pytest.fixture(scope="module")
def flight():
    return flown(make(), seed=1)


@pytest.mark.parametrize(
    ("settings", "space"),
    [
        ({"observation": "state", "camera": {}, "randomization": {}}, ((25,), np.float32)),
        ({"observation": "pixels"}, ((16, 16, 3), np.uint8)),
        ({"observation": "pixels", "camera": {**CAMERA, "channels": "gray"}}, ((16, 16, 1), np.uint8)),
        ({"observation": "pixels", "camera": {**CAMERA, "channels": "depth"}}, ((16, 16, 1), np.float32)),
    ],
)
def test_one_part_is_an_array(settings, space):
    env = make(**settings)
    assert (env.observation_space.shape, env.observation_space.dtype) == space


def test_both_parts_are_a_dict():
    for space in (
        make().observation_space,
        gymnasium.make_vec("ISS-v0", num_envs=2, **SEEING).single_observation_space,
    ):
        assert set(space) == {"state", "pixels"}
        assert space["pixels"] == gymnasium.spaces.Box(0, 255, (16, 16, 3), np.uint8)


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"observation": "pixel"}, "unknown observation 'pixel'; did you mean 'pixels'"),
        ({"observation": "pixels", "camera": {"width": 0}}, "camera.width: must be at least 1"),
        (
            {"observation": "pixels", "camera": {"view": "chaser_fvp"}},
            "unknown camera 'chaser_fvp'; did you mean 'chaser_fpv'",
        ),
        ({"observation": "pixels", "camera": {"channels": "grey"}}, "unknown channels 'grey'; did you mean 'gray'"),
        ({"observation": "pixels", "camera": {"widht": 3}}, "did you mean 'camera.width'"),
        ({"observation": "pixels", "camera": {"visitors": ["zvezda_aff"]}}, "did you mean 'zvezda_aft'"),
        ({"camera": {"width": 32}}, "camera has settings, but the observation 'state' has no pixels"),
        ({"randomization": RANGES}, "randomization.camera has settings, but the observation 'state' has no pixels"),
        ({"observation": "pixels", "camera": {"view": "station_top", "field_deg": 60.0}}, "orthographic"),
    ],
)
def test_mistakes_are_named(settings, says):
    with pytest.raises(ValueError, match=says):
        load_config(**settings)


CHANGES = {
    "view": "chaser_top", "height": 17, "width": 17, "channels": "gray", "every": 7, "samples": 2, "field_deg": 50.0,
    "position": (0.0, 0.0, 1.0), "exposure": 1.0, "sky": False, "sun": 2.0, "lamp": 3.0, "visitors": ("zvezda_aft",),
    **{("effects", name): 0.5 for name in EffectsConfig.model_fields},
    **{("ranges", name): (0.25, 0.75) for name in CameraRanges.model_fields},
}  # fmt: skip


def test_every_setting_reaches_the_sensor():
    """A field that changes neither the structure nor a number would be a knob without a wire."""

    def told(config, ranges):
        sensor = CameraSensor(config, ranges)
        own = sensor.default_params()
        ranges = None if own.ranges is None else [np.asarray(part) for part in own.ranges]
        effects = None if own.effects is None else [np.asarray(part) for part in own.effects]
        return repr(
            (config.structure, jax.tree.leaves((own.scene.light, own.scene.visitors, own.camera)), effects, ranges)
        )

    plain = told(CameraConfig(), CameraRanges())
    maps = {"earth_map", "cloud_map", "night_map"}  # tested with the sky
    assert {name if isinstance(name, str) else name[0] for name in CHANGES} | {"port"} | maps == {
        *CameraConfig.model_fields,
        "ranges",
    }
    for name, value in CHANGES.items():
        group, name = name if isinstance(name, tuple) else (None, name)
        ranges = CameraRanges(**{name: value}) if group == "ranges" else CameraRanges()
        effects = {"effects": EffectsConfig(**{name: value})} if group == "effects" else {}
        config = CameraConfig(**effects) if group else CameraConfig(**{name: value})
        assert told(config, ranges) != plain, name
    inside = [
        told(CameraConfig(view="station_fpv", port=port), CameraRanges()) for port in ("zvezda_aft", "pirs_nadir")
    ]
    assert inside[0] != inside[1]


@pytest.mark.slow
def test_frames_come_when_due_and_are_held_between(flight):
    seen, infos = flight
    frames = [one["pixels"] for one in seen]
    assert [info["pixels_age"] for info in infos] == [count % EVERY for count in range(8)]
    for count in range(1, 8):
        assert np.array_equal(frames[count], frames[count - 1]) == (count % EVERY != 0)
    assert len(np.unique(frames[0].reshape(-1, 3), axis=0)) > 5, "something is to be seen"


@pytest.mark.slow
def test_a_frame_is_the_camera_s_picture_of_the_truth(flight):
    from owm_envs.camera.effects import looking
    from owm_envs.camera.light import heavens
    from owm_envs.camera.render import render
    from owm_envs.dynamics.chief import kepler_orbit
    from owm_envs.dynamics.state import PhysicalState

    seen, infos = flight
    with jax.enable_x64(True):
        env = make().unwrapped.docking_env
        params = env.default_params()
        own, info = params.sensors["pixels"], infos[EVERY]
        drawn = {
            k.removeprefix("drawn_pixels_"): jnp.asarray(v) for k, v in info.items() if k.startswith("drawn_pixels_")
        }
        look = env.sensors[1].draw(own, jax.random.key(0))._replace(**drawn)
        scene, lens = looking(own.scene, own.camera, look)
        start = jnp.asarray(infos[0]["epoch"])
        orbit = kepler_orbit(params, PhysicalState(start, jnp.asarray(EVERY * 0.05), start[:0], None))
        scene = scene._replace(heavens=heavens(jnp.asarray(info["epoch"]), orbit[:3], orbit[3:]))
        picture = jax.jit(render)(scene, View.of(jnp.asarray(info["true_state"])), lens)["rgb"]
    difference = np.abs(seen[EVERY]["pixels"].astype(int) - np.asarray(picture))
    assert np.mean(difference > 2) < 0.01


@pytest.mark.slow
def test_the_state_part_is_that_of_an_environment_without_pixels(flight):
    plain, _ = flown(gymnasium.make("ISS-v0", config=CONFIG), seed=1)
    np.testing.assert_array_equal([one["state"] for one in flight[0]], plain)


@pytest.mark.slow
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_slots_of_a_batch_are_scalar_environments(mode):
    """Two episodes on end of three slots, the second after an automatic reset or one by mask."""
    envs = gymnasium.make_vec("ISS-v0", num_envs=3, autoreset_mode=mode, **SEEING)
    scalar = [make() for _ in range(3)]
    observation, _ = envs.reset(seed=1)
    expected = [env.reset(seed=1 + slot)[0] for slot, env in enumerate(scalar)]

    def same(slot, batch, one):
        for name, value in one.items():
            np.testing.assert_array_equal(batch[name][slot], value, err_msg=name)

    for slot, one in enumerate(expected):
        same(slot, observation, one)
    ended = np.zeros(3, bool)
    for action in np.concatenate([ACTIONS, ACTIONS]):
        if mode is AutoresetMode.DISABLED and ended.any():
            observation, _ = envs.reset(options={"reset_mask": ended})
            for slot in np.flatnonzero(ended):
                same(slot, observation, scalar[slot].reset()[0])
        observation, _, terminated, truncated, info = envs.step(np.tile(action, (3, 1)))
        assert observation in envs.observation_space
        for slot, env in enumerate(scalar):
            if mode is AutoresetMode.NEXT_STEP and ended[slot]:
                same(slot, observation, env.reset()[0])
                continue
            last, _, _, _, told = env.step(action)
            if mode is AutoresetMode.SAME_STEP and (terminated | truncated)[slot]:
                same(slot, info["final_obs"], last)
                assert info["final_info"]["pixels_age"][slot] == told["pixels_age"]
                last = env.reset()[0]
            same(slot, observation, last)
        ended = terminated | truncated
    assert envs.unwrapped.traces["step"] == envs.unwrapped.traces["reset"] == 1


@pytest.mark.slow
def test_numbers_compile_nothing(flight):
    one = make()
    before = one.unwrapped.traces
    other = make(camera={**CAMERA, "lamp": 0.0, "exposure": 2.0, "field_deg": 40.0, "sun": 3.0})
    seen, _ = flown(other, seed=1)
    assert other.unwrapped.traces == before
    assert not np.array_equal(seen[0]["pixels"], flight[0][0]["pixels"])
    np.testing.assert_array_equal(seen[-1]["state"], flight[0][-1]["state"])


@pytest.mark.slow
def test_pixels_alone_are_the_same_frames(flight):
    seen, infos = flown(make(observation="pixels"), [], seed=1)
    np.testing.assert_array_equal(seen[0], flight[0][0]["pixels"])
    np.testing.assert_array_equal(infos[0]["measured_state"], flight[1][0]["measured_state"])


@pytest.mark.slow
def test_an_environment_with_pixels_pickles(flight):
    env = make().unwrapped
    env.reset(seed=1)
    copy = pickle.loads(pickle.dumps(env))
    for action, seen in zip(ACTIONS[:3], flight[0][1:]):
        for one in (env, copy):
            observation = one.step(action)[0]
            for name, value in seen.items():
                np.testing.assert_array_equal(observation[name], value, err_msg=name)


def drawn_of(info):
    return {name: np.array(value) for name, value in info.items() if name.startswith("drawn_pixels_")}


def test_a_reset_may_draw_some_of_it_anew():
    env = make()
    first = drawn_of(env.reset(seed=4)[1])
    second = drawn_of(env.reset(options={"variation": ["light"]})[1])
    changed = {name for name in first if not np.array_equal(first[name], second[name])}
    assert changed == {"drawn_pixels_sun_scale"}
    third = drawn_of(env.reset(options={"variation": ["camera", "material"]})[1])
    changed = {name for name in first if not np.array_equal(third[name], second[name])}
    assert changed == {"drawn_pixels_tilt", "drawn_pixels_albedo_scale"}
    fourth = drawn_of(env.reset()[1])
    assert all(not np.array_equal(third[name], fourth[name]) for name in changed | {"drawn_pixels_sun_scale"})
    with pytest.raises(ValueError, match="unknown variation 'lihgt'; did you mean 'light'"):
        env.reset(options={"variation": ["lihgt"]})
    with pytest.raises(ValueError, match=r"unknown variation 'orbit'.* known: light, camera, material"):
        env.reset(options={"variation": ["orbit"]})
    with pytest.raises(ValueError, match="nothing to draw from"):
        gymnasium.make("ISS-v0", config=CONFIG).reset(options={"variation": ["light"]})


@dataclass(frozen=True)
class Counter:
    """A costly sensor that counts how often it is asked."""

    asked: ClassVar[list] = []
    name: str = "count"
    shape: tuple[int, ...] = ()
    dtype: str = "int32"
    every: int = 4
    may_miss: ClassVar[bool] = False
    costly: ClassVar[bool] = True

    def measure(self, key, truth):
        """Measure."""
        jax.debug.callback(lambda count: self.asked.append(int(count)), truth.count)
        return truth.count.astype(jnp.int32)


def test_a_costly_sensor_is_asked_only_where_it_is_due(x64):
    env = DockingEnv({**CONFIG, "horizon": 0.3}, sensors=(Counter(),))
    params = env.default_params()
    reset = jax.jit(jax.vmap(lambda key: env.reset(params, key=key)))
    step = jax.jit(jax.vmap(env.step, (None, 0, None)))
    Counter.asked.clear()
    state, _ = reset(jax.random.split(jax.random.key(0), 5))
    jax.effects_barrier()
    assert Counter.asked == [0] * 5
    state = state._replace(count=jnp.asarray([0, 1, 2, 3, 3], state.count.dtype))
    ages = []
    for _ in range(6):
        state, _ = step(params, state, jnp.zeros(6))
        ages.append(state.measured["count_age"].tolist())
    jax.effects_barrier()
    # After the sixth decision nothing is asked, though an ended slot may stand at an instant that is due.
    assert sorted(Counter.asked[5:]) == [4] * 5
    assert [row[0] for row in ages] == [1, 2, 3, 0, 1, 2]
    assert [row[4] for row in ages] == [0, 1, 2, 2, 2, 2], "an ended episode's frame grows no older"


def test_gradients_pass_a_costly_sensor_by(x64):
    env = DockingEnv(CONFIG, sensors=(Counter(every=1),))
    params = env.default_params()
    state, _ = jax.jit(env.reset)(params, key=jax.random.key(0))

    def loss(action):
        after, _ = env.step(params, state, action)
        return View.of(after.view).velocity.sum()

    assert np.abs(jax.jit(jax.grad(loss))(jnp.ones(6))).max() > 0


def test_effects_are_what_they_say():
    from owm_envs.camera.effects import effects_from, spoiled
    from owm_envs.config.camera import EffectsConfig

    grey = jnp.full((32, 32, 3), 188, jnp.uint8)  # half of white, in light
    edge = grey.at[:, 16:].set(0)
    spoil = jax.jit(lambda image, effects: spoiled(image, effects, key=jax.random.key(0)))
    of = lambda **sizes: effects_from(EffectsConfig(**sizes))
    np.testing.assert_array_equal(spoil(edge, of()), edge)
    assert not spoil(grey, of(blocked=1.0)).any()
    light = lambda image: ((np.asarray(image) / 255.0 + 0.055) / 1.055) ** 2.4
    assert light(spoil(grey, of(shot_noise=0.05))).std() == pytest.approx(0.05 * 0.5**0.5, rel=0.05)
    assert light(spoil(grey, of(read_noise=0.02))).std() == pytest.approx(0.02, rel=0.05)
    blurred = light(spoil(edge, of(blur=2.0)))[16, :, 0]
    assert (np.diff(blurred[8:24]) <= 1e-6).all() and blurred[16] == pytest.approx(0.5 * 0.401, abs=0.02)


@pytest.mark.slow
def test_frames_freeze_and_cameras_shake():
    effects = {"frozen": 1.0, "attitude_deg": 1.0, "exposure": 0.5}
    env = make(camera={**CAMERA, "every": 1, "effects": effects}, randomization={})
    seen, infos = flown(env, ACTIONS[:3], seed=1)
    assert [info["pixels_age"] for info in infos] == [0, 1, 2, 3]
    for one in seen[1:]:
        np.testing.assert_array_equal(one["pixels"], seen[0]["pixels"])
    assert seen[0]["pixels"].any()


def test_each_chaser_of_a_fleet_has_pixels():
    from owm_envs.pettingzoo import parallel_env

    env = parallel_env(2, **SEEING)
    observations, infos = env.reset(seed=3)
    for agent, observation in observations.items():
        assert observation in env.observation_space(agent) and infos[agent]["pixels_age"] == 0
    assert not np.array_equal(*(one["pixels"] for one in observations.values()))


@pytest.mark.parametrize(
    "code", ["import owm_envs.env", "import gymnasium, owm_envs; gymnasium.make('ISS-v0').reset()"]
)
def test_a_state_only_environment_imports_no_camera(code):
    code += "; import sys; seen = [m for m in sys.modules if m.startswith('owm_envs.camera')]; assert not seen, seen"
    subprocess.run([sys.executable, "-c", code], check=True)
