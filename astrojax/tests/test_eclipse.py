"""The conical shadow against brahe, and against the solar disc sampled ray by ray."""

import brahe
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from astrojax import constants, ephemeris

SUN = np.array([-9.4e10, 1.09e11, 4.7e10])


def arc(radius, angles):
    """Positions at angles [rad] from the point opposite the Sun."""
    shadow = -SUN / np.linalg.norm(SUN)
    side = np.cross(shadow, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    return radius * (np.cos(angles)[:, None] * shadow + np.sin(angles)[:, None] * side)


def penumbra(radius, count):
    """Positions across the whole penumbra of one side, umbra and sunlight at its ends."""
    edge = np.arcsin(constants.R_EARTH / radius)
    return arc(radius, edge + np.linspace(-0.006, 0.006, count))


def illumination(positions, dtype="float64"):
    fn = jax.jit(jax.vmap(lambda r: ephemeris.illumination_conical(r, jnp.asarray(SUN, dtype))))
    return np.asarray(fn(jnp.asarray(positions, dtype)))


def test_against_brahe(rng, x64):
    """Over a sphere of directions and across the penumbra, from 200 km to the distance of the Moon."""
    for radius in (6.58e6, 6.8e6, 4.2e7, 3.8e8):
        directions = rng.normal(size=(200, 3))
        positions = np.concatenate(
            [radius * directions / np.linalg.norm(directions, axis=1, keepdims=True), penumbra(radius, 200)]
        )
        expected = np.array([brahe.eclipse_conical(r, SUN) for r in positions])
        assert {0.0, 1.0} <= set(expected)
        np.testing.assert_allclose(illumination(positions), expected, rtol=0, atol=1e-6)


def test_against_the_sampled_disc(x64):
    """Rays to 20 000 points of the solar disc, blocked or not by a sphere: the planar overlap is within 1e-3."""
    index = np.arange(20_000) + 0.5
    rho, phi = np.sqrt(index / index.size), np.pi * (1 + 5**0.5) * index
    positions = penumbra(6.8e6, 41)
    for position, visible in zip(positions, illumination(positions)):
        to_sun = SUN - position
        distance = np.linalg.norm(to_sun)
        first = np.cross(to_sun, [0.0, 0.0, 1.0])
        first /= np.linalg.norm(first)
        second = np.cross(to_sun / distance, first)
        # The limb is where rays graze the Sun's sphere: a disc a little nearer than its centre, a little smaller.
        sine = constants.R_SUN / distance
        disc = constants.R_SUN * np.sqrt(1 - sine**2) * rho[:, None]
        rays = to_sun * (1 - sine**2) + disc * (np.cos(phi)[:, None] * first + np.sin(phi)[:, None] * second)
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        along = rays @ position
        blocked = (along < 0) & (position @ position - along**2 < constants.R_EARTH**2)
        assert visible == pytest.approx(1 - blocked.mean(), abs=1e-3)


def test_an_annular_eclipse_leaves_the_ring(x64):
    """Far behind the Earth its disc is the smaller one: what is left is one minus the ratio of the discs."""
    far = arc(3e9, np.zeros(1))
    distance = np.linalg.norm(SUN) + 3e9
    ratio = (np.arcsin(constants.R_EARTH / 3e9) / np.arcsin(constants.R_SUN / distance)) ** 2
    assert illumination(far)[0] == pytest.approx(1 - ratio, abs=1e-12)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_monotone_and_smooth_through_the_penumbra(dtype, x64):
    """From 0 to 1 without a step back beyond rounding; gradients finite at the contacts and on the axis too."""
    positions = np.concatenate([penumbra(6.8e6, 4001), arc(6.8e6, np.array([0.0, np.pi]))])
    visible = illumination(positions[:-2], dtype)
    assert visible[0] == 0 and visible[-1] == 1
    assert np.diff(visible).min() >= (-1e-12 if dtype == "float64" else -1e-4)
    slope = jax.jit(jax.vmap(jax.grad(lambda r: ephemeris.illumination_conical(r, jnp.asarray(SUN, dtype)))))
    gradient = np.asarray(slope(jnp.asarray(positions, dtype)))
    assert gradient.dtype == dtype and np.all(np.isfinite(gradient))
    # Half way, the limb sweeps over the disc's diameter: 22 km there, 2.36e6 m from the vehicle.
    diameter = 2 * constants.R_SUN / np.linalg.norm(SUN) * np.sqrt(6.8e6**2 - constants.R_EARTH**2)
    assert np.linalg.norm(gradient, axis=1).max() == pytest.approx(4 / (np.pi * diameter), rel=0.03)
    assert not gradient[[0, -3, -2, -1]].any()  # in the umbra, in sunlight and on the axis
