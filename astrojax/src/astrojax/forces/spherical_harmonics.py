"""Gravity in spherical harmonics of any degree and order, without a singularity at the poles.

The solid harmonics V_nm + i W_nm = P_nm(sin latitude) exp(i m longitude) (R/r)^(n+1), fully normalised, follow for each
order m by a recursion in the degree n, started from the power m of (x + i y) R / r^2: nothing but products and sums of
Cartesian coordinates. A derivative of a solid harmonic is one of the next degree, so each component of the acceleration
is a sum over the same functions, with coefficients of its own (Cunningham). Orders are the lanes of a vector; a long
order shares its lane with a short one, so that all lanes are busy at every step of the one loop.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from astrojax._types import FloatScalar, Matrix3, Scalar, Vector3, inverse_norm
from astrojax.forces.environment import Environment
from astrojax.forces.force import Traced, field_difference, force, static, turned, turned_back
from astrojax.forces.gravity_field import GravityField
from astrojax.forces.spacecraft import Spacecraft

_UNROLLED = 28
"""Steps of the loop that are written out: a short one wholly, which a compiler keeps in registers; of a longer one that
many at a time."""
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


def _powers(x: FloatScalar, y: FloatScalar, exponents: np.ndarray) -> tuple[Array, Array]:
    """Real and imaginary part of (x + i y) to each of the exponents, by repeated squaring."""
    re, im = jnp.full(exponents.shape, _SCALE, x.dtype), jnp.zeros(exponents.shape, x.dtype)
    bit = 0
    while exponents.max(initial=0) >> bit:
        takes = (exponents >> bit) & 1 == 1
        re, im = jnp.where(takes, re * x - im * y, re), jnp.where(takes, re * y + im * x, im)
        x, y = x * x - y * y, 2 * x * y
        bit += 1
    return re, im


def _synthesis(r: Vector3, radius: Scalar, degree: int, order: int, tables: list) -> list[FloatScalar]:
    """Sums of C V + S W over degrees 0 to `degree`, orders to `order`, for each pair (C, S) of `tables`.

    The tables are (degree + 1, order + 1). One factor R / r is left out of V and W.
    """
    lanes = _lanes(degree, order)
    dtype = r.dtype
    inv_r = inverse_norm(r)
    ratio = radius * inv_r
    x, y, z = (ratio * inv_r) * r
    square = ratio * ratio
    re, im = _powers(x, y, lanes.orders)
    seeds = jnp.asarray(lanes.seeds, dtype)
    re, im = re * seeds, im * seeds
    live = lanes.degree >= 0
    pick = (np.where(live, lanes.degree, 0), np.where(live, lanes.order, 0))
    gathered = [jnp.where(live, jnp.asarray(table, dtype)[pick], 0.0) for pair in tables for table in pair]
    if all(isinstance(table, np.ndarray) for pair in tables for table in pair):
        gathered = [jnp.asarray(np.where(live, table[pick], 0.0), dtype) for pair in tables for table in pair]
    rows = [jnp.asarray(table, dtype) for table in (lanes.ahead, lanes.behind, lanes.restart)] + gathered

    def advance(carry, row):
        (v1, w1, v2, w2), sums = carry
        ahead, behind, restart, *coefficients = row
        up, down = ahead * z, behind * square
        v = up * v1 - down * v2 + restart * re[1]
        w = up * w1 - down * w2 + restart * im[1]
        sums = [s + (c * v + d * w) for s, c, d in zip(sums, coefficients[::2], coefficients[1::2])]
        return ((v, w, v1, w1), sums), None

    nothing = jnp.zeros_like(re[0])
    first = [c[0] * re[0] + d[0] * im[0] for c, d in zip(gathered[::2], gathered[1::2])]
    carry = ((re[0], im[0], nothing, nothing), first)
    steps = len(lanes.degree)
    if steps <= _UNROLLED:
        for i in range(1, steps):
            carry, _ = advance(carry, [row[i] for row in rows])
    else:
        carry, _ = jax.lax.scan(advance, carry, [row[1:] for row in rows], unroll=8)
    return [jnp.sum(s) * (1.0 / _SCALE) for s in carry[1]]


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

    Validity: outside the body, poles included; to degree 360. Relative error at degree 200: 1e-14 in float64.
    Raises: ValueError, degree or order out of range.

    Source: Cunningham 1970, Celestial Mechanics 2, 207; normalised recursion: Holmes and Featherstone 2002, Journal of
    Geodesy 76, 279, eq. 11 and 12.
    """
    degree, order = _checked(field, degree, order)
    tables = _derivative_tables(field.c, field.s, degree, order)
    inv_r = inverse_norm(r)
    # The factor R / r that was left out of the functions, and gm / R^2.
    scale = field.gm / field.radius * inv_r
    return scale * jnp.stack(_synthesis(r, field.radius, degree + 1, order + 1, tables))


def potential_spherical_harmonics(
    r: Vector3, field: GravityField, degree: int, order: int | None = None
) -> FloatScalar:
    """Potential [m^2/s^2] whose gradient is `accel_spherical_harmonics`, arguments as there (central term left out)."""
    degree, order = _checked(field, degree, order)
    mask = np.tril(np.ones((degree + 1, order + 1)))
    mask[0, 0] = 0.0
    tables = [tuple(table[: degree + 1, : order + 1] * mask.astype(table.dtype) for table in (field.c, field.s))]
    return field.gm * inverse_norm(r) * _synthesis(r, field.radius, degree, order, tables)[0]


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

    def _field(self, environment: Environment):
        rotation: Matrix3 = environment.required("rotation", "SphericalHarmonics")

        def inertial(r):
            fixed = accel_spherical_harmonics(turned(rotation, r), self.field, self.degree, self.order)
            return turned_back(rotation, fixed)

        return inertial

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return self._field(environment)(r)

    def relative(
        self,
        t: Scalar,
        r: Vector3,
        v: Vector3,
        rho: Vector3,
        rho_dot: Vector3,
        chief: Spacecraft,
        spacecraft: Spacecraft,
        environment: Environment,
    ) -> Vector3:
        """By subtraction in float64, by expansion in float32: see `field_difference`."""
        return field_difference(self._field(environment), r, rho)
