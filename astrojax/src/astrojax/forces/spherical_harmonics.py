"""Gravity in spherical harmonics of any degree and order, without a singularity at the poles.

The solid harmonics V_nm + i W_nm = P_nm(sin latitude) exp(i m longitude) (R/r)^(n+1), fully normalised, follow for each
order m by a recursion in the degree n, started from the power m of (x + i y) R / r^2: nothing but products and sums of
Cartesian coordinates. A derivative of a solid harmonic is one of the next degree, so each component of the acceleration
is a sum over the same functions, with coefficients of its own (Cunningham). Orders are the lanes of a vector; a long
order shares its lane with a short one, so that all lanes are busy at every step of the one loop.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from astrojax._types import FloatScalar, Matrix3, Scalar, Vector3, inverse_norm
from astrojax.forces.base import Traced, force, static, turned, turned_back
from astrojax.forces.environment import Environment
from astrojax.forces.fields import GravityField
from astrojax.forces.spacecraft import Spacecraft

_SCALE = 2.0**64
"""Of the functions on the way: keeps the small powers of high orders in the range of float32."""


class _Lanes(NamedTuple):
    """Which order and degree each lane is at in each step, and the factors of the recursion there."""

    degree: np.ndarray  # (steps, lanes), -1 where idle
    order: np.ndarray
    ahead: np.ndarray  # of z R / r^2 times the function one degree below
    behind: np.ndarray  # of (R / r)^2 times that two below
    restart: np.ndarray  # 1 where the lane's second order begins
    orders: np.ndarray  # (2, lanes) the first and the second order of each lane
    seeds: np.ndarray  # (2, lanes) normalised sectoral factor of each, 0 for none


@functools.cache
def _lanes(degree: int, order: int) -> _Lanes:
    """Columns m = 0 to `order`, each of degrees m to `degree`, two to a lane: the longest with the shortest."""
    columns = list(range(order + 1))
    pairs = []
    steps = degree + 1  # the longest column
    while columns:
        first = columns.pop(0)
        length = degree + 1 - first
        second = None
        if columns and (length + degree + 1 - columns[-1] <= steps + 1):
            second = columns.pop()
            steps = max(steps, length + degree + 1 - second)
        pairs.append((first, second))
    count = len(pairs)
    shape = (steps, count)
    n, m = np.full(shape, -1), np.zeros(shape, int)
    restart = np.zeros(shape)
    orders, seeds = np.zeros((2, count), int), np.zeros((2, count))
    sectoral = np.sqrt(np.cumprod([1.0, 3.0, *((2 * k + 1) / (2 * k) for k in range(2, order + 1))]))
    for lane, pair in enumerate(pairs):
        step = 0
        for which, column in enumerate(pair):
            if column is None:
                continue
            length = degree + 1 - column
            n[step : step + length, lane] = np.arange(column, degree + 1)
            m[step : step + length, lane] = column
            restart[step, lane] = which
            orders[which, lane], seeds[which, lane] = column, sectoral[column]
            step += length
    above = n > m
    k, j = np.where(above, n, 1), np.where(above, m, 0)
    ahead = np.where(above, np.sqrt((2 * k - 1) * (2 * k + 1) / ((k - j) * (k + j))), 0.0)
    twice = n > m + 1
    k, j = np.where(twice, n, 2), np.where(twice, m, 0)
    behind = np.sqrt((2 * k + 1) * (k + j - 1) * (k - j - 1) / ((k - j) * (k + j) * (2 * k - 3)))
    return _Lanes(n, m, ahead, np.where(twice, behind, 0.0), restart, orders, seeds)


def _powers(x: Array, y: Array, exponents: np.ndarray) -> tuple[Array, Array]:
    """Real and imaginary part of (x + i y) to each of the exponents, along the first axis, by repeated squaring."""
    exponents = exponents.reshape(exponents.shape + (1,) * (x.ndim - 1))
    shape = np.broadcast_shapes(exponents.shape, x.shape)
    re, im = jnp.full(shape, _SCALE, x.dtype), jnp.zeros(shape, x.dtype)
    bit = 0
    while exponents.max(initial=0) >> bit:
        takes = np.broadcast_to((exponents >> bit) & 1 == 1, shape)
        re, im = jnp.where(takes, re * x - im * y, re), jnp.where(takes, re * y + im * x, im)
        x, y = x * x - y * y, 2 * x * y
        bit += 1
    return re, im


def _sums(degree: int, order: int, r: Array, radius: Array, tables: tuple[tuple[Array, Array], ...]) -> Array:
    """Sums of C V + S W over degrees 0 to `degree`, orders 0 to `order`, for each pair (C, S) of `tables`.

    Any axes of `r` after the first are a batch. The tables are (degree + 1, order + 1). One factor R / r is left out
    of V and W.
    """
    lanes = _lanes(degree, order)
    inv_r = jax.lax.rsqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2])
    ratio = radius * inv_r
    shrink = ratio * inv_r
    # A leading axis for the lanes, written out: ranks are not promoted here.
    x, y, z = ((shrink * component)[None] for component in r)
    square = (ratio * ratio)[None]

    def rows(table):
        return jnp.asarray(table, r.dtype).reshape(np.shape(table) + (1,) * (r.ndim - 1))

    seeds = rows(lanes.seeds)
    (re1, im1), (re2, im2) = (
        tuple(part * seeds[which] for part in _powers(x, y, lanes.orders[which])) for which in (0, 1)
    )
    live = lanes.degree >= 0
    pick = (np.where(live, lanes.degree, 0), np.where(live, lanes.order, 0))
    mask = live.astype(r.dtype)
    pairs = [tuple(rows(table[pick] * mask) for table in pair) for pair in tables]
    factors = tuple(rows(table) for table in (lanes.ahead, lanes.behind, lanes.restart))

    def advance(carry, row):
        (v1, w1, v2, w2), sums = carry
        (ahead, behind, restart), coefficients = row
        up, down = ahead * z, behind * square
        v = up * v1 - down * v2 + restart * re2
        w = up * w1 - down * w2 + restart * im2
        sums = [so_far + (c * v + s * w) for so_far, (c, s) in zip(sums, coefficients)]
        return ((v, w, v1, w1), sums), None

    nothing = jnp.zeros_like(re1)
    carry = ((re1, im1, nothing, nothing), [c[0] * re1 + s[0] * im1 for c, s in pairs])
    # A short loop is written out. Else two steps at a time: each then writes where the one before last was read from.
    steps = jax.tree.map(lambda table: table[1:], (factors, pairs))
    count = len(lanes.degree) - 1
    (_, sums), _ = jax.lax.scan(advance, carry, steps, unroll=count if count <= 8 else 2)
    return jnp.stack([jnp.sum(lane, axis=0) for lane in sums]) * (1.0 / _SCALE)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _synthesis(degree: int, order: int, r: Array, radius: Array, tables: tuple) -> Array:
    """`_sums`; a batch of positions goes through it as the last axis, where a vector unit takes several at once."""

    @jax.custom_batching.custom_vmap
    def one(r, radius, tables):
        return _sums(degree, order, r, radius, tables)

    @one.def_vmap
    def _(axis_size, batched, r, radius, tables):
        if batched[0] and not any(jax.tree.leaves(batched[1:])):
            return jnp.moveaxis(_sums(degree, order, jnp.moveaxis(r, 0, -1), radius, tables), -1, 0), True
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, tuple(batched))
        return jax.vmap(functools.partial(_sums, degree, order), axes)(r, radius, tables), True

    return one(r, radius, tables)


def _synthesis_jvp(degree, order, primals, tangents):
    # Differentiated, it is the sums themselves: those can be transposed. Constant coefficients cost nothing here.
    leaves, structure = jax.tree.flatten(primals)
    slopes = jax.tree.leaves(tangents)
    moving = [i for i, slope in enumerate(slopes) if not isinstance(slope, jax.custom_derivatives.SymbolicZero)]

    def sums(*moved):
        values = list(leaves)
        for i, value in zip(moving, moved):
            values[i] = value
        return _sums(degree, order, *jax.tree.unflatten(structure, values))

    return jax.jvp(sums, [leaves[i] for i in moving], [slopes[i] for i in moving])


_synthesis.defjvp(_synthesis_jvp, symbolic_zeros=True)


def _derivative_tables(c: Any, s: Any, degree: int, order: int) -> list:
    """Coefficients of the three components of the acceleration, over functions of one degree and order more.

    Source: Montenbruck and Gill, Satellite Orbits, eq. 3.33, with the ratios of the normalisation factors.
    """
    xp = np if isinstance(c, np.ndarray) and isinstance(s, np.ndarray) else jnp
    size = (degree + 1, order + 1)
    mask = np.tril(np.ones(size))
    mask[0, 0] = 0.0  # the central term
    c, s = c[: size[0], : size[1]] * mask, s[: size[0], : size[1]] * mask
    n, m = np.indices(size)
    low = np.where(m <= n, m, 0)  # above the diagonal anything finite will do
    same = (2 * n + 1) / (2 * n + 3)
    up = 0.5 * np.sqrt(same * (n + low + 1) * (n + low + 2)) * np.where(m == 0, np.sqrt(2.0), 1.0)
    down = 0.5 * np.sqrt(same * (n - low + 1) * (n - low + 2)) * np.where(m == 1, np.sqrt(2.0), 1.0)
    straight = np.sqrt(same * (n + low + 1) * (n - low + 1))

    def placed(table, shift):
        """One degree up, and `shift` orders up."""
        if shift < 0:
            table, shift, right = table[:, 1:], 0, 2
        else:
            right = 1 - shift
        return xp.pad(table, ((1, 0), (shift, right)))

    up, down, straight = (xp.asarray(factor, dtype=c.dtype) for factor in (up, down, straight))
    return [
        (placed(down * c, -1) - placed(up * c, 1), placed(down * s, -1) - placed(up * s, 1)),
        (placed(down * s, -1) + placed(up * s, 1), -placed(down * c, -1) - placed(up * c, 1)),
        (-placed(straight * c, 0), -placed(straight * s, 0)),
    ]


def _checked(field: GravityField, degree: int, order: int | None) -> tuple[int, int]:
    order = degree if order is None else order
    for name, value, limit in (("degree", degree, field.degree), ("order", order, degree)):
        if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value <= limit:
            which = f"the {field.name or 'field'}'s" if name == "degree" else "the degree"
            raise ValueError(f"{name}: expected a static integer from 0 to {limit}, {which}, got {value!r}")
    return degree, order


def accel_spherical_harmonics(r: Vector3, field: GravityField, degree: int, order: int | None = None) -> Vector3:
    """Acceleration [m/s^2] of a gravity field's harmonics, the central term left out.

    Args:
        r: (3,) position from the body's centre in its own axes [m].
        field: coefficients.
        degree: static, 0 to the field's.
        order: static, 0 to `degree`; None for `degree`.

    Validity: outside the body, poles included; to degree 360. Relative error at degree 200: 1e-14 in float64,
    1e-5 in float32.
    Raises: ValueError, degree or order out of range.

    Source: Cunningham 1970, Celestial Mechanics 2, 207; normalised recursion: Holmes and Featherstone 2002, Journal of
    Geodesy 76, 279, eq. 11 and 12.
    """
    degree, order = _checked(field, degree, order)
    tables = _derivative_tables(field.c, field.s, degree, order)
    inv_r = inverse_norm(r)
    # The factor R / r that was left out of the functions, and gm / R^2.
    scale = field.gm / field.radius * inv_r
    return scale * _synthesis(degree + 1, order + 1, r, *_cast(r.dtype, field.radius, tables))


def potential_spherical_harmonics(
    r: Vector3, field: GravityField, degree: int, order: int | None = None
) -> FloatScalar:
    """Potential [m^2/s^2] whose gradient is `accel_spherical_harmonics`, arguments as there (central term left out)."""
    degree, order = _checked(field, degree, order)
    mask = np.tril(np.ones((degree + 1, order + 1)))
    mask[0, 0] = 0.0
    tables = [tuple(table[: degree + 1, : order + 1] * mask.astype(table.dtype) for table in (field.c, field.s))]
    return field.gm * inverse_norm(r) * _synthesis(degree, order, r, *_cast(r.dtype, field.radius, tables))[0]


def _cast(dtype: Any, radius: Scalar, tables: list) -> tuple:
    """Radius and tables as arrays of one dtype, as `_synthesis` differentiates them."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype), (radius, tuple(map(tuple, tables))))


@force
class SphericalHarmonics:
    """A gravity field's harmonics without its central term, in axes fixed to the body; goes with `PointMass(field.gm)`.

    Args:
        field: a `GravityField`: `gravity_field("EGM2008")`, `load_gfc(path)` or one's own.
        degree, order: static; order None for `degree`.

    Raises: ValueError, degree or order out of range.
    """

    field: Traced
    degree: int = static()
    order: int | None = static(default=None)

    needs = frozenset({"rotation"})

    def __post_init__(self) -> None:
        if isinstance(self.field, GravityField) and hasattr(self.field.c, "shape"):
            _checked(self.field, self.degree, self.order)

    def acceleration_field(self, environment: Environment) -> Callable[[Vector3], Vector3]:
        """The acceleration [m/s^2] as a function of the inertial position [m] alone."""
        rotation: Matrix3 = environment.required("rotation", "SphericalHarmonics")

        def inertial(r):
            fixed = accel_spherical_harmonics(turned(rotation, r), self.field, self.degree, self.order)
            return turned_back(rotation, fixed)

        return inertial

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return self.acceleration_field(environment)(r)
