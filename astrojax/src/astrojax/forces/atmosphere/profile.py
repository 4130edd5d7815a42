"""Temperature against height, and what it makes of the density of a gas: Bates' profile above, cubic splines below.

The density of a gas of mass m and thermal diffusion coefficient a at height z is that at the base times
exp((1 + a) A(z) + m B(z)). A and B depend on the temperature alone, so one profile serves all gases.

Source: Picone et al. (2002), appendix A; Bates (1959), Proc. R. Soc. London A 253, 451; Walker (1965), J. Atmos. Sci.
22, 462.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from astrojax._types import FloatScalar

GAS = 831.4  # the model's gas constant, in its units: g, cm, km
BASE = 120.0  # height at which Bates' profile is given [km]
NODES = (110.0, 100.0, 90.0, 72.5)  # of the spline under it [km]


class Planet(NamedTuple):
    """The Earth under one latitude: gravity at sea level [cm/s^2], effective radius [km]."""

    gravity: FloatScalar
    radius: FloatScalar

    def at(self, height: ArrayLike) -> Array:
        """Gravity at a height [km]."""
        return self.gravity / (1.0 + height / self.radius) ** 2

    def rise(self, height: ArrayLike, start: ArrayLike) -> Array:
        """Geopotential height above `start` [km], in units of its own gravity."""
        return (height - start) * (self.radius + start) / (self.radius + height)


def planet(cos_double_latitude: FloatScalar) -> Planet:
    """The Earth under a latitude, given by the cosine of its double."""
    gravity = 980.616 * (1.0 - 0.0026373 * cos_double_latitude)
    return Planet(gravity, 2.0 * gravity / (3.085462e-6 + 2.27e-9 * cos_double_latitude) * 1.0e-5)


class Layer(NamedTuple):
    """A clamped cubic spline of inverse temperature over geopotential height, from the top node down.

    Attributes:
        top: height of the first node [km]; bottom: of the last.
        span: geopotential height between them, negative.
        x: (N,) nodes, from 0 to 1; y: inverse temperatures; bend: second derivatives.
        pull: inverse scale height of a unit mass, times temperature, over the span.
    """

    top: FloatScalar
    bottom: FloatScalar
    span: FloatScalar
    x: Float[Array, "N"]
    y: Float[Array, "N"]
    bend: Float[Array, "N"]
    pull: FloatScalar


def layer(earth: Planet, heights: tuple, temperatures: Float[Array, "N"], slopes: tuple) -> Layer:
    """The spline through temperatures.

    Args:
        heights: N nodes [km], falling.
        temperatures: (N,) at the nodes [K].
        slopes: dT/dz at the first node and at the last, in the geopotential height of the first [K/km].
    """
    top, bottom = heights[0], heights[-1]
    span = earth.rise(bottom, top)
    x = jnp.stack([earth.rise(z, top) / span for z in heights])
    y = 1.0 / temperatures
    stretched = ((earth.radius + bottom) / (earth.radius + top)) ** 2
    first = -slopes[0] * y[0] * y[0] * span
    last = -slopes[1] * y[-1] * y[-1] * span * stretched
    ends = (jnp.asarray(height, span.dtype) for height in (top, bottom))
    return Layer(*ends, span, x, y, _bends(x, y, first, last), earth.at(top) * span / GAS)


def _bends(x, y, first, last):
    """Second derivatives of a clamped cubic spline: its tridiagonal system, eliminated forwards and backwards."""
    step = x[1:] - x[:-1]
    slope = (y[1:] - y[:-1]) / step
    n = len(y)
    ratio, value = [-0.5 * jnp.ones_like(first)], [3.0 / step[0] * (slope[0] - first)]
    for i in range(1, n - 1):
        both = step[i - 1] + step[i]
        share = step[i - 1] / both
        pivot = share * ratio[-1] + 2.0
        ratio.append((share - 1.0) / pivot)
        value.append((6.0 * (slope[i] - slope[i - 1]) / both - share * value[-1]) / pivot)
    bends = [(3.0 / step[-1] * (last - slope[-1]) - 0.5 * value[-1]) / (0.5 * ratio[-1] + 1.0)]
    for i in range(n - 2, -1, -1):
        bends.append(ratio[i] * bends[-1] + value[i])
    return jnp.stack(bends[::-1])


def descend(earth: Planet, spline: Layer, height: FloatScalar) -> tuple[FloatScalar, FloatScalar]:
    """Temperature [K], and logarithm of pressure gained by a gas of unit mass, down from the layer's top.

    Args:
        height: [km]; held at the layer's ends.
    """
    height = jnp.clip(height, spline.bottom, spline.top)
    x = earth.rise(height, spline.top) / spline.span
    low, high, step = spline.x[:-1], spline.x[1:], spline.x[1:] - spline.x[:-1]
    ya, yb, ca, cb = spline.y[:-1], spline.y[1:], spline.bend[:-1], spline.bend[1:]

    # The interval the height lies in, and every interval's part above the height.
    inside = (x >= low) & ((x < high) | (np.arange(len(low)) == len(low) - 1))
    reached = jnp.clip(x, low, high)
    a, b = (high - reached) / step, (reached - low) / step
    square = step * step / 6.0
    inverse = a * ya + b * yb + ((a**3 - a) * ca + (b**3 - b) * cb) * square
    a2, b2 = a * a, b * b
    part = 0.5 * ((1.0 - a2) * ya + b2 * yb)
    part += ((0.5 * a2 - 0.25 * (1.0 + a2 * a2)) * ca + (0.25 * b2 * b2 - 0.5 * b2) * cb) * square
    return 1.0 / jnp.sum(jnp.where(inside, inverse, 0.0)), -spline.pull * jnp.sum(part * step)


class Thermosphere(NamedTuple):
    """Bates' profile over a spline.

    Attributes:
        join: height at which the two meet [km].
        exosphere, base: temperatures at the top and at 120 km [K]; shape: inverse scale of their approach [1/km].
        below: the spline from the join down.
        nodes, slope: what it was made from.
    """

    join: FloatScalar
    exosphere: FloatScalar
    base: FloatScalar
    shape: FloatScalar
    below: Layer
    nodes: Float[Array, "M"]
    slope: FloatScalar


def thermosphere(
    earth: Planet,
    exosphere: FloatScalar,
    base: FloatScalar,
    shape: FloatScalar,
    heights: tuple,
    nodes: Float[Array, "M"],
    slope: FloatScalar,
) -> Thermosphere:
    """The profile.

    Args:
        exosphere, base, shape: as in `Thermosphere`.
        heights: nodes of the spline [km], from the join down.
        nodes: (M,) temperatures at the nodes below the join [K].
        slope: dT/dz at the lowest node, as `layer` takes it.
    """
    join = jnp.asarray(heights[0], base.dtype)
    meeting = exosphere - (exosphere - base) * jnp.exp(-shape * earth.rise(join, BASE))
    rate = (exosphere - meeting) * shape * ((earth.radius + BASE) / (earth.radius + join)) ** 2
    below = layer(earth, heights, jnp.concatenate([meeting[None], nodes]), (rate, slope))
    return Thermosphere(join, exosphere, base, shape, below, nodes, slope)


def factors(earth: Planet, profile: Thermosphere, height: FloatScalar) -> tuple[FloatScalar, FloatScalar, FloatScalar]:
    """Temperature [K], and the A and B of the density, at a height [km]."""
    rise = earth.rise(jnp.maximum(height, profile.join), BASE)
    bates = profile.exosphere - (profile.exosphere - profile.base) * jnp.exp(-profile.shape * rise)
    spline, gained = descend(earth, profile.below, height)
    temperature = jnp.where(height < profile.join, spline, bates)
    pull = earth.at(BASE) / (profile.shape * GAS * profile.exosphere)
    lost = pull * (jnp.log(profile.base / bates) - profile.shape * rise)
    return temperature, jnp.log(profile.base / temperature), lost + gained
