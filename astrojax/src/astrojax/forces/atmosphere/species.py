"""The gases of the thermosphere: each diffuses by its own weight high up and is mixed with the others lower down.

Densities are logarithms here: a gas spans twenty powers of ten from the ground to the exosphere.

Source: Picone et al. (2002), as in `tables`; Hedin (1987), J. Geophys. Res. 92(A5), 4649, for the turbopause and the
chemical corrections.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from astrojax.compilation import stored
from astrojax.forces.atmosphere import tables as t
from astrojax.forces.atmosphere.profile import GAS, NODES, Planet, Thermosphere, factors, thermosphere

MASSES = np.array([4.0, 16.0, 28.0, 32.0, 40.0, 1.0, 14.0])  # He, O, N2, O2, Ar, H, N
MIXED_MASS = 28.95
_DIFFUSION = np.array([-0.38, 0.0, 0.0, 0.0, 0.17, -0.38, 0.0])
_SEPARATED = np.array([200.0, 300.0, 160.0, 250.0, 240.0, 320.0, 450.0])  # no mixing above [km]
_NITROGEN, _OXYGEN, _OXYGEN2 = 2, 1, 3
_YEAR, _LIMIT = 1.72142e-2, 40.0


def densities(
    earth: Planet, profile: Thermosphere, height: ArrayLike, varied: Array, weight: Callable, at: Any
) -> tuple:
    """Logarithms of the densities [1/cm^3] at a height of 72.5 km or more.

    Args:
        varied: (11,) the upper expansions.
        weight: of a switch, by its number.
        at: the `Moment`.

    Returns:
        (7,) of the gases; of the fully mixed air's nitrogen; of hot oxygen; and the temperature [K].
    """
    dtype = varied.dtype
    density, turbo = t.tables().density, t.tables().turbopause
    rows = t.tables().upper[:, 0]
    mass, diffusion = jnp.asarray(MASSES, dtype), jnp.asarray(_DIFFUSION, dtype)

    # At 120 km, and from there by diffusion to the height and to each gas's turbopause.
    species = np.array(t.SPECIES)
    base = jnp.asarray(np.log(density[:7, 0] * rows[species]), dtype) + weight(21) * varied[species]
    wave = jnp.cos(_YEAR * (at.day - float(t.tables().upper[t.EXOSPHERE, 13])))
    seasonal = weight(5) * float(turbo[0, 24]) * at.legendre[1] * wave
    turbopause = jnp.asarray(density[:7, 2], dtype)
    swing = jnp.asarray(np.where(np.arange(7) == _NITROGEN, turbo[1, 24], 0.0), dtype)
    turbopause = turbopause * (jnp.asarray(np.arange(7) != _NITROGEN, dtype) + swing * (1.0 + seasonal))
    along = jax.vmap(lambda z: factors(earth, profile, z))
    temperature, a, b = stored(along(jnp.concatenate([turbopause, height[None]])))
    a_turbo, b_turbo, a, b = a[:7], b[:7], a[7], b[7]
    diffused = base + (1.0 + diffusion) * a + mass * b
    mixed_base = base + diffusion * a_turbo + (mass - MIXED_MASS) * b_turbo
    mixed = mixed_base + a + MIXED_MASS * b

    # The two meet at the turbopause; above, the gas is on its own.
    sharpness = float(density[2, 3] * turbo[1, 5]) / (MIXED_MASS - mass)
    excess = sharpness * (mixed - diffused)
    joined = diffused + jnp.logaddexp(excess, jnp.zeros_like(excess)) / sharpness
    joined = jnp.where(excess < -10.0, diffused, jnp.where(excess > 10.0, mixed, joined))

    flux = 1.0 + weight(1) * float(turbo[0, 23]) * (at.f107a - 150.0)
    corrected = joined + _to_ground(height, mixed_base, flux, density, turbo, dtype)
    chemistry = _chemistry(height, flux, density, turbo, dtype)
    inside = height <= jnp.asarray(_SEPARATED, dtype)
    always = jnp.arange(7) == _OXYGEN2  # molecular oxygen departs from diffusion at all heights
    departure = jnp.where(inside, corrected - diffused + chemistry, jnp.where(always, chemistry, 0.0))
    logs = diffused + weight(15) * departure
    return logs, mixed[_NITROGEN], _hot_oxygen(earth, profile, height, varied, weight), temperature[7]


def _step(height, size, middle, scale, scale2):
    """A correction of `size` far below `middle` that vanishes far above it."""
    first, second = (jnp.clip((height - middle) / h, -_LIMIT, _LIMIT) for h in (scale, scale2))
    return size / (1.0 + 0.5 * (jnp.exp(first) + jnp.exp(second)))


def _to_ground(height, mixed_base, flux, density, turbo, dtype):
    """What brings each gas to its share of the air at the ground; atomic oxygen's is given, nitrogen is the measure."""
    share = density[:7, 1] * np.array([1.0, 1.0, 1.0, 1.0, 1.0, abs(turbo[1, 17]), abs(turbo[0, 2])])
    share[_NITROGEN] = 1.0
    size = mixed_base[_NITROGEN] - mixed_base + jnp.asarray(np.log(share), dtype)
    oxygen = float(density[1, 1] * turbo[1, 16]) * flux
    size = jnp.where(jnp.arange(7) == _OXYGEN, oxygen, size)
    at = [(1, 0), (1, 2), (0, 7), (1, 6), (1, 8), (1, 10), (0, 0)]
    wide = [(1, 1), (1, 3), (0, 7), (1, 7), (1, 9), (1, 11), (0, 1)]
    middle = density[:7, 4] * np.array([turbo[i] for i in at])
    scale = density[:7, 5] * np.array([turbo[i] for i in wide])
    scale[_NITROGEN] = 1.0
    scale2 = np.where(np.arange(7) == _OXYGEN, density[1, 5] * turbo[1, 4], scale)
    return _step(height, size, *(jnp.asarray(x, dtype) for x in (middle, scale, scale2)))


def _chemistry(height, flux, density, turbo, dtype):
    """What chemistry takes from O, O2, H and N, or leaves of them."""
    size, middle, scale, scale2 = np.zeros(7), np.zeros(7), np.ones(7), np.ones(7)
    columns = {1: ((1, 14), (1, 12), (1, 13)), 5: ((1, 20), (1, 18), (1, 19)), 6: ((0, 5), (0, 3), (0, 4))}
    columns[_OXYGEN2] = ((1, 23), (1, 21), (1, 22))
    for i, (strength, where, wide) in columns.items():
        size[i], middle[i] = density[i, 3] * turbo[strength], density[i, 6] * turbo[where]
        scale[i] = scale2[i] = density[i, 7] * turbo[wide]
    scale2[_OXYGEN2] = density[_OXYGEN2, 7] * turbo[0, 22]
    sizes = jnp.asarray(size, dtype) * jnp.where(jnp.arange(7) == _OXYGEN2, flux, 1.0)
    return _step(height, sizes, *(jnp.asarray(x, dtype) for x in (middle, scale, scale2)))


def _hot_oxygen(earth, profile, height, varied, weight):
    """Logarithm of the density of oxygen at a temperature of its own, falling off below 550 km."""
    density, turbo = t.tables().density[7].tolist(), t.tables().turbopause
    dtype = varied.dtype
    hot = jnp.asarray(density[9] * float(turbo[0, 6]), dtype)
    base = float(np.log(density[0] * t.tables().upper[t.HOT, 0])) + weight(21) * varied[t.HOT]
    join = float(turbo[1, 15])
    own = stored(thermosphere(earth, hot, hot, profile.shape, (join, *NODES), profile.nodes, profile.slope))
    _, a, b = factors(earth, own, height)
    scale = GAS * hot / (earth.at(density[4]) * 16.0)
    fall = density[5] / scale * (jnp.exp(-(height - density[4]) / density[5]) - 1.0)
    return base + a + 16.0 * b - fall
