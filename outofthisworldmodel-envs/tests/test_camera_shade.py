"""Light on a surface: no material creates energy, and what is matt follows Lambert's law."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from owm_envs.camera.render import render
from owm_envs.camera.scene import default_scene
from owm_envs.camera.shade import Lights, developed, encoded, radiance
from owm_envs.camera.solids import solids
from owm_envs.camera.surface import MATERIAL_NAMES, Look, linear
from owm_envs.camera.views import aimed, camera
from owm_envs.station.primitives import box
from owm_envs.view import View

_UP = (0.0, 0.0, 1.0)


def _lights(sun=_UP, sunlight=0.0, earth_sine=0.5, earthshine=0.0, bounce=0.0, lamp=0.0, down=_UP):
    number = lambda value: jnp.asarray(value, jnp.float32)
    return Lights(*map(number, (sun, sunlight, down, earth_sine, earthshine, bounce, lamp)))


def _look(colour, metallic, roughness):
    number = lambda value: jnp.asarray(value, jnp.float32)
    zero = number(0.0)
    return Look((number(colour),) * 3, number(metallic), number(roughness), (zero, zero, zero))


def _vector(values):
    return tuple(jnp.asarray(v, jnp.float32) for v in values)


@jax.jit
def _seen(lights, look, normal, to_eye):
    far, lit = jnp.asarray(10.0, jnp.float32), jnp.asarray(1.0, jnp.float32)
    return radiance(lights, look, normal, to_eye, far, lit)[0]


@jax.jit
def _reflected(look, to_eye):
    """Share of an even sky's light, sky of small suns, that goes towards the eye: a midpoint rule."""
    rows, columns = 400, 800
    height = (jnp.arange(rows, dtype=jnp.float32) + 0.5) / rows
    turn = 2.0 * np.pi * (jnp.arange(columns, dtype=jnp.float32) + 0.5) / columns
    sine = jnp.sqrt(1.0 - height * height)
    grid = jnp.stack(
        jnp.broadcast_arrays(
            sine[:, None] * jnp.cos(turn)[None, :], sine[:, None] * jnp.sin(turn)[None, :], height[:, None]
        ),
        axis=-1,
    ).reshape(-1, 3)
    one = lambda sun: _seen(_lights()._replace(sun=sun, sunlight=jnp.ones((), jnp.float32)), look, _vector(_UP), to_eye)
    # Radiance counts in that of a white matt plane, so it holds pi times the reflectance.
    return 2.0 * jax.vmap(one)(grid).mean()


@pytest.mark.parametrize("metallic", [0.0, 0.5, 1.0])
@pytest.mark.parametrize("roughness", [0.2, 0.45, 0.7, 1.0])
def test_white_surface_under_an_even_sky_sends_no_more_than_it_gets(metallic, roughness):
    look, shares = _look(1.0, metallic, roughness), []
    for degrees in (0.0, 40.0, 65.0, 80.0, 87.0):
        angle = np.radians(degrees)
        shares.append(float(_reflected(look, _vector((np.sin(angle), 0.0, np.cos(angle))))))
    assert max(shares) <= 1.005, shares
    assert min(shares) > 0.1, shares


@pytest.mark.parametrize("metallic", [0.0, 1.0])
@pytest.mark.parametrize("roughness", [0.05, 0.3, 1.0])
def test_light_from_all_sides_and_from_the_earth_create_no_energy(metallic, roughness):
    for cosine in (1.0, 0.5, 0.1, 0.02):
        eye = _vector((np.sqrt(1.0 - cosine**2), 0.0, cosine))
        for light in (_lights(bounce=1.0), _lights(earth_sine=1.0, earthshine=1.0)):
            assert float(_seen(light, _look(1.0, metallic, roughness), _vector(_UP), eye)) <= 1.001


def _matt(normal, eye, sun, **light):
    """The part of radiance that grows with colour: white less black, without metal."""
    lights = _lights(sun=sun, **light)
    return float(_seen(lights, _look(1.0, 0.0, 1.0), _vector(normal), _vector(eye))) - float(
        _seen(lights, _look(0.0, 0.0, 1.0), _vector(normal), _vector(eye))
    )


def _passed(cosine):
    return 1.0 - (1.0 - cosine) ** 5


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 85.0, 95.0])
def test_lit_plane_is_lamberts_under_the_loss_to_the_gloss(degrees):
    sun = (np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees)))
    cosine = max(sun[2], 0.0)
    expected = 0.96 * cosine * _passed(cosine)
    np.testing.assert_allclose(_matt(_UP, _UP, sun, sunlight=1.0), expected, atol=2e-6)


def _on_all(lights, look, normals):
    one = lambda normal: _seen(lights, look, (normal[0], normal[1], normal[2]), _vector(_UP))
    return jax.vmap(one)(jnp.asarray(normals, jnp.float32))


def test_lit_sphere_sends_as_much_as_the_closed_form():
    """Under a phase angle p: 2/3 (sin p + (pi - p) cos p) / pi of what a plane as wide sends. Source: Lambert, 1760."""
    # Points even over the disc that the eye sees.
    radius, turn = np.sqrt((np.arange(4000) + 0.5) / 4000), 2.399963 * np.arange(4000)
    x, y = radius * np.cos(turn), radius * np.sin(turn)
    normals = np.stack([x, y, np.sqrt(1.0 - radius**2)], axis=1)
    for phase in (0.0, 0.8, 2.0):
        sun = np.array([np.sin(phase), 0.0, np.cos(phase)])
        lights = _lights(sun=sun, sunlight=1.0)
        white, black = (_on_all(lights, _look(colour, 0.0, 1.0), normals) for colour in (1.0, 0.0))
        facing = np.maximum(normals @ sun, 0.0)
        lost = _passed(facing) * _passed(normals[:, 2])
        closed = 2.0 / 3.0 * (np.sin(phase) + (np.pi - phase) * np.cos(phase)) / np.pi
        np.testing.assert_allclose(facing.mean(), closed, rtol=2e-3)
        seen = np.asarray(white - black) / 0.96
        np.testing.assert_allclose(seen, facing * lost, atol=1e-5)
        assert 0.7 * closed < seen.mean() <= closed


def test_lamp_falls_with_the_square_of_distance():
    look, normal = _look(0.5, 0.0, 1.0), _vector(_UP)
    near, far = (
        float(radiance(_lights(lamp=1.0), look, normal, normal, jnp.asarray(d, jnp.float32), jnp.ones(()))[0])
        for d in (10.0, 30.0)
    )
    np.testing.assert_allclose(near / far, 9.0, rtol=1e-5)


def test_development_rises_and_stays_in_range():
    light = jnp.concatenate([jnp.zeros(1), jnp.geomspace(1e-6, 1e9, 400)]).astype(jnp.float32)
    shown = np.asarray(developed(light))
    assert (np.diff(shown) >= 0).all() and shown[0] == 0.0 and shown[-1] <= 1.0
    assert (np.diff(np.asarray(encoded(jnp.linspace(0.0, 1.0, 500, dtype=jnp.float32))).astype(int)) >= 0).all()


@pytest.mark.parametrize("samples", [1, 6])
def test_shadow_of_an_edge_is_as_soft_as_the_sun_is_wide(samples):
    """A plate 40 m above a floor, the Sun above both: at the edge of its shadow a disc is hidden bit by bit."""
    floor = box("floor", (-30.0, 30.0), (-30.0, 30.0), (-1.0, 0.0), "white", "a test")
    plate = box("plate", (-30.0, 0.0), (-30.0, 30.0), (40.0, 40.01), "white", "a test")
    plain = default_scene()
    above = jnp.asarray([0.0, 0.0, 1.0], jnp.float32)
    scene = plain._replace(station=solids((floor, plate), MATERIAL_NAMES), heavens=plain.heavens._replace(sun=above))
    eye = camera(
        "station_top",
        height=24,
        width=24,
        samples=samples,
        field=0.6,
        position=(0.0, 0.0, 20.0),
        attitude=aimed((0, 0, 20), (0, 0, 0), (0, 1, 0)),
    )
    away = View.of(np.array([1e5, 0.0, 0.0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0], np.float32))
    rows = np.asarray(linear(jax.jit(render)(scene, away, eye)["rgb"][..., 1] / 255.0))
    lit = (rows.mean(axis=0) - rows.min()) / (rows.max() - rows.min())
    place = 0.025 * (np.arange(24) - 11.5) / (40.0 * np.tan(float(scene.heavens.sun_radius)))
    edge = np.clip(place, -1.0, 1.0)
    hidden = (np.arccos(edge) - edge * np.sqrt(1.0 - edge**2)) / np.pi  # the segment of a disc
    expected = 1.0 - hidden if samples > 1 else (place > 0).astype(float)
    assert (np.abs(place) > 1).sum() >= 8 and (np.abs(place) < 1).sum() >= 12
    np.testing.assert_allclose(lit, expected, atol=0.05)
