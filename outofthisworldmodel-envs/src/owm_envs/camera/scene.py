"""What a picture shows: the station, the chaser, visitors, their materials and the sky."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from astrojax.attitude import quat_to_rotation
from owm_envs.camera.light import Heavens
from owm_envs.camera.shade import Light, default_light
from owm_envs.camera.sky import Sky
from owm_envs.camera.solids import Solids, joined, moved, solids
from owm_envs.camera.surface import MATERIAL_NAMES, Materials, materials
from owm_envs.station.chaser import CHASER
from owm_envs.station.details import DETAILS
from owm_envs.station.parts import PARTS
from owm_envs.view import View


class Visitors(NamedTuple):
    """Other Dragons, docked or flying free."""

    position: Float[Array, "V 3"]
    """m, station frame."""
    attitude: Float[Array, "V 4"]
    """Unit quaternions, scalar first, body to station."""
    present: Bool[Array, "V"]


class Scene(NamedTuple):
    """All that a picture shows, but for where the chaser is and the light: traced leaves all."""

    station: Solids
    """Rows of `PARTS`, then of `DETAILS`."""
    chaser: Solids
    """In its body frame; visitors look alike."""
    visitors: Visitors
    materials: Materials
    light: Light
    heavens: Heavens
    sky: Sky | None
    """None is black."""


def default_scene(visitors: int = 0, sky: Sky | None = None) -> Scene:
    """Give the station and the chaser as their tables have them.

    Args:
        visitors: how many places for them there are, all empty.
        sky: as `load_sky` gives it; black when None.
    """
    nobody = Visitors(
        jnp.zeros((visitors, 3), jnp.float32),
        jnp.tile(jnp.asarray([[1.0, 0.0, 0.0, 0.0]], jnp.float32), (visitors, 1)),
        jnp.zeros(visitors, bool),
    )
    station, chaser = solids((*PARTS, *DETAILS), MATERIAL_NAMES), solids(CHASER, MATERIAL_NAMES)
    return Scene(station, chaser, nobody, materials(), default_light(), noon(), sky)


def noon() -> Heavens:
    """Give heavens to draw by when no epoch is given: the Sun from forward, starboard and above."""
    number = lambda value: jnp.asarray(value, jnp.float32)
    sun = np.array([-0.66, -0.56, 0.50])
    turn = np.eye(3)
    return Heavens(
        sun=number(sun / np.linalg.norm(sun)),
        sun_radius=number(0.00465),
        sunlight=number(1.0),
        moon=number([1.0, 0.0, 0.0]),
        moon_radius=number(0.0045),
        earth=number([0.0, 0.0, -6.78e6]),
        earth_from_station=number(turn),
        icrf_from_station=number(turn),
    )


def assembled(scene: Scene, view: View) -> Solids:
    """Give all parts in the station frame: the station's, the chaser's, each visitor's, float32."""
    position, attitude = (jnp.asarray(part, jnp.float32) for part in (view.position, view.attitude))
    vehicles = [moved(scene.chaser, position, quat_to_rotation(attitude), jnp.ones((), bool))]
    for number in range(scene.visitors.present.shape[0]):
        turn = quat_to_rotation(scene.visitors.attitude[number])
        vehicles.append(moved(scene.chaser, scene.visitors.position[number], turn, scene.visitors.present[number]))
    return joined([scene.station, *vehicles])
