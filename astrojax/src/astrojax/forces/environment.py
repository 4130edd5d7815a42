"""What forces need to know of the world at an instant: computed once, shared by a batch of vehicles."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import jax.numpy as jnp

from astrojax._types import Matrix3, Scalar, Vector3
from astrojax.ephemeris import PLANETS, moon_position, planet_position_geocentric, sun_position
from astrojax.time import earth_rotation_angle


class Environment(NamedTuple):
    """The world at an instant, in inertial axes (GCRF) about Earth's centre; what no force reads may stay None."""

    sun: Vector3 | None = None  # position [m]
    moon: Vector3 | None = None  # position [m]
    planets: dict[str, Vector3] | None = None  # positions [m] by lower-case name
    rotation: Matrix3 | None = None  # inertial to Earth-fixed axes (GCRF to ITRF)
    epoch: tuple[Scalar, Scalar] | None = None  # UTC: whole MJD, seconds of day
    weather: Any = None  # space weather, whatever the atmosphere in use asks for

    def required(self, name: str, force: str) -> Any:
        """The value of a field or the position of a planet; ValueError naming the force if it is not there."""
        value = getattr(self, name) if name in self._fields else (self.planets or {}).get(name)
        if value is None:
            raise ValueError(f"environment: {force} needs {name!r}, which was not given")
        return value

    def in_body_axes(self) -> "Environment":
        """The same world seen along Earth-fixed axes that do not turn: all positions times `rotation`."""
        rotation = self.required("rotation", "in_body_axes")

        def turn(position):
            return None if position is None else rotation @ position

        planets = self.planets and {name: turn(position) for name, position in self.planets.items()}
        fixed = jnp.eye(3, dtype=rotation.dtype)
        return self._replace(sun=turn(self.sun), moon=turn(self.moon), planets=planets, rotation=fixed)


def earth_rotation(day: Scalar, seconds: Scalar) -> Matrix3:
    """Rotation from inertial to Earth-fixed axes that turns about the pole of J2000 by the Earth rotation angle.

    Args:
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.

    Validity: precession, nutation and polar motion are left out (0.15 deg in 2026), UT1 is UTC (0.9 s, 14 arcseconds).
    The angle counts from the celestial intermediate origin, which stays by the inertial x axis: sidereal time, counted
    from the equinox of date, would turn the Earth 0.33 deg too far in 2026.

    Source: IERS Conventions (2010), TN 36, eq. 5.5, without Q and W.
    """
    angle = earth_rotation_angle(day, seconds)
    cos, sin = jnp.cos(angle), jnp.sin(angle)
    zero, one = jnp.zeros_like(cos), jnp.ones_like(cos)
    return jnp.stack([jnp.stack([cos, sin, zero]), jnp.stack([-sin, cos, zero]), jnp.stack([zero, zero, one])])


_COMPUTED = {
    "sun": sun_position,
    "moon": moon_position,
    "rotation": earth_rotation,
    "epoch": lambda day, seconds: (day, seconds),
}
"""How each quantity follows from a UTC epoch."""


def environment_at(needs: Iterable[str], day: Scalar, seconds: Scalar, **given: Any) -> Environment:
    """What `needs` names, at a UTC epoch.

    Args:
        needs: static names, as in `Force.needs`.
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        given: fields of `Environment` that replace what would be computed: a better rotation, an ephemeris of one's
            own, space weather.

    Validity: analytic Sun and Moon, planets by their approximate elements, and `earth_rotation`, unless given. In the
    0.05 s of a short step the Moon moves 50 m, 1e-7 of its distance: once a step is plenty.
    Raises: ValueError, a need that is neither given nor computed here, or a given name that is no field.
    """
    unknown = sorted(set(given) - set(Environment._fields))
    if unknown:
        raise ValueError(f"given: expected fields of Environment {Environment._fields}, got {unknown}")
    planets = dict(given.get("planets") or {})
    values = dict(given)
    for name in sorted(set(needs) - set(given) - set(planets)):
        if name in PLANETS:
            values["planets"] = planets = planets | {name: planet_position_geocentric(name, day, seconds)}
            continue
        if name not in _COMPUTED:
            raise ValueError(
                f"environment: {name!r} is needed and not computed here ({sorted(_COMPUTED)} and planets are): give it "
                + ("as `weather`" if name == "weather" else f"as planets={{{name!r}: position}}")
            )
        values[name] = _COMPUTED[name](day, seconds)
    return Environment(**values)
