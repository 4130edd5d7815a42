"""Approximate positions of the planets: Keplerian elements that change linearly with time.

Two tables, each fitted to JPL's ephemerides over its interval: "1800-2050", and "3000BC-3000AD" with a few more terms
of the mean anomaly. Positions are geometric (no light time, no aberration), in EME2000, the mean equator and equinox of
J2000.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from astrojax import constants as c
from astrojax._types import Scalar, Vector3, Vector6, float_dtype
from astrojax.ephemeris.sun_moon import moon_position
from astrojax.time import centuries_tt, phase, tai_minus_utc

PLANETS = (
    "mercury", "venus", "emb", "earth", "mars", "jupiter", "saturn", "uranus", "neptune", "pluto",
)  # fmt: skip
"""Bodies of the tables; "emb" is the barycentre of Earth and Moon, from which "earth" is found."""

# Semi-major axis [au], eccentricity, inclination, mean longitude, longitude of perihelion, longitude of the node [deg]
# at J2000.0, mean ecliptic and equinox of J2000, and the change of each in a Julian century.
# Source: E. M. Standish, Keplerian Elements for Approximate Positions of the Major Planets (JPL), tables 1, 2a and 2b.
_TABLES = {
    "1800-2050": {
        "mercury": (
            (0.38709927, 0.20563593, 7.00497902, 252.25032350, 77.45779628, 48.33076593),
            (0.00000037, 0.00001906, -0.00594749, 149472.67411175, 0.16047689, -0.12534081),
        ),
        "venus": (
            (0.72333566, 0.00677672, 3.39467605, 181.97909950, 131.60246718, 76.67984255),
            (0.00000390, -0.00004107, -0.00078890, 58517.81538729, 0.00268329, -0.27769418),
        ),
        "emb": (
            (1.00000261, 0.01671123, -0.00001531, 100.46457166, 102.93768193, 0.0),
            (0.00000562, -0.00004392, -0.01294668, 35999.37244981, 0.32327364, 0.0),
        ),
        "mars": (
            (1.52371034, 0.09339410, 1.84969142, -4.55343205, -23.94362959, 49.55953891),
            (0.00001847, 0.00007882, -0.00813131, 19140.30268499, 0.44441088, -0.29257343),
        ),
        "jupiter": (
            (5.20288700, 0.04838624, 1.30439695, 34.39644051, 14.72847983, 100.47390909),
            (-0.00011607, -0.00013253, -0.00183714, 3034.74612775, 0.21252668, 0.20469106),
        ),
        "saturn": (
            (9.53667594, 0.05386179, 2.48599187, 49.95424423, 92.59887831, 113.66242448),
            (-0.00125060, -0.00050991, 0.00193609, 1222.49362201, -0.41897216, -0.28867794),
        ),
        "uranus": (
            (19.18916464, 0.04725744, 0.77263783, 313.23810451, 170.95427630, 74.01692503),
            (-0.00196176, -0.00004397, -0.00242939, 428.48202785, 0.40805281, 0.04240589),
        ),
        "neptune": (
            (30.06992276, 0.00859048, 1.77004347, -55.12002969, 44.96476227, 131.78422574),
            (0.00026291, 0.00005105, 0.00035372, 218.45945325, -0.32241464, -0.00508664),
        ),
        "pluto": (
            (39.48211675, 0.24882730, 17.14001206, 238.92903833, 224.06891629, 110.30393684),
            (-0.00031596, 0.00005170, 0.00004818, 145.20780515, -0.04062942, -0.01183482),
        ),
    },
    "3000BC-3000AD": {
        "mercury": (
            (0.38709843, 0.20563661, 7.00559432, 252.25166724, 77.45771895, 48.33961819),
            (0.00000000, 0.00002123, -0.00590158, 149472.67486623, 0.15940013, -0.12214182),
        ),
        "venus": (
            (0.72332102, 0.00676399, 3.39777545, 181.97970850, 131.76755713, 76.67261496),
            (-0.00000026, -0.00005107, 0.00043494, 58517.81560260, 0.05679648, -0.27274174),
        ),
        "emb": (
            (1.00000018, 0.01673163, -0.00054346, 100.46691572, 102.93005885, -5.11260389),
            (-0.00000003, -0.00003661, -0.01337178, 35999.37306329, 0.31795260, -0.24123856),
        ),
        "mars": (
            (1.52371243, 0.09336511, 1.85181869, -4.56813164, -23.91744784, 49.71320984),
            (0.00000097, 0.00009149, -0.00724757, 19140.29934243, 0.45223625, -0.26852431),
        ),
        "jupiter": (
            (5.20248019, 0.04853590, 1.29861416, 34.33479152, 14.27495244, 100.29282654),
            (-0.00002864, 0.00018026, -0.00322699, 3034.90371757, 0.18199196, 0.13024619),
        ),
        "saturn": (
            (9.54149883, 0.05550825, 2.49424102, 50.07571329, 92.86136063, 113.63998702),
            (-0.00003065, -0.00032044, 0.00451969, 1222.11494724, 0.54179478, -0.25015002),
        ),
        "uranus": (
            (19.18797948, 0.04685740, 0.77298127, 314.20276625, 172.43404441, 73.96250215),
            (-0.00020455, -0.00001550, -0.00180155, 428.49512595, 0.09266985, 0.05739699),
        ),
        "neptune": (
            (30.06952752, 0.00895439, 1.77005520, 304.22289287, 46.68158724, 131.78635853),
            (0.00006447, 0.00000818, 0.00022400, 218.46515314, 0.01009938, -0.00606302),
        ),
        "pluto": (
            (39.48686035, 0.24885238, 17.14104260, 238.96535011, 224.09702598, 110.30167986),
            (0.00449751, 0.00006016, 0.00000501, 145.18042903, -0.00968827, -0.00809981),
        ),
    },
}
# Added to the mean anomaly [deg] with the long table: b t^2 + c cos(f t) + s sin(f t).
_ANOMALY = {
    "jupiter": (-0.00012452, 0.06064060, -0.35635438, 38.35125000),
    "saturn": (0.00025899, -0.13434469, 0.87320147, 38.35125000),
    "uranus": (0.00058331, -0.97731848, 0.17689245, 7.67025000),
    "neptune": (-0.00041348, 0.68346318, -0.10162547, 7.67025000),
    "pluto": (-0.01262724, 0.0, 0.0, 0.0),
}
TABLES = tuple(_TABLES)
"""Spans of years of the two tables of elements."""
_INTERVALS = {"1800-2050": (-21504, 70172), "3000BC-3000AD": (-1774303, 417151)}  # MJD, Gregorian years

_OBLIQUITY = math.radians(23.43928)  # of the tables' own description
_EARTH_OVER_MOON = 81.30056822149722  # DE440 (Park et al. 2021)


def planet_position(body: str, day: Scalar, seconds: Scalar, table: str = "1800-2050") -> Vector3:
    """Heliocentric position of a planet [m], EME2000.

    Args:
        body: "mercury", "venus", "emb", "earth", "mars", "jupiter", "saturn", "uranus", "neptune" or "pluto"; static.
        day: whole MJD, UTC.
        seconds: seconds of day [s], UTC.
        table: "1800-2050" or "3000BC-3000AD"; static.

    Validity: largest error over 1800 to 2050 against ERFA `plan94` (Earth `epv00`) and JPL's DE421, in arcsec seen from
    the Sun, and in 1e6 km of distance: Mercury 31 (0.003), Venus 28 (0.007), Earth and EMB 25 (0.009), Mars 104
    (0.042), Jupiter 517 (0.67), Saturn 740 (2.9), Uranus 148 (1.7), Neptune 66 (1.7), Pluto 59 (1.3, 1900 to 2050). The
    long table over 1000 to 3000: 36 (0.003), 97 (0.018), 62 (0.021), 185 (0.08), 790 (1.4), 1470 (5.2), 1265 (8.3), 535
    (5.0), Pluto 230 (2.1, 1900 to 2050); before 1000 AD it is not measured. Outside its interval a table is wrong
    without bound: `planet_status` tells. float32: 1 arcsec more.

    Raises:
        ValueError: the body or the table is unknown.

    Source: Standish, Keplerian Elements for Approximate Positions of the Major Planets (JPL).
    """
    if body not in PLANETS:
        raise ValueError(f"body: expected one of {', '.join(PLANETS)}, got {body!r}")
    if table not in TABLES:
        raise ValueError(f"table: expected one of {', '.join(TABLES)}, got {table!r}")
    dtype = float_dtype(day, seconds)
    position = _keplerian("emb" if body == "earth" else body, day, jnp.asarray(seconds, dtype), table)
    if body == "earth":
        moon = moon_position(day, jnp.asarray(seconds, dtype))
        position = position - moon / (1.0 + _EARTH_OVER_MOON)
    return position


def planet_status(day: Scalar, table: str = "1800-2050") -> Int[Array, ""]:
    """Whether an epoch is inside a table's interval: 0 it is, 1 before it, 2 after it.

    Args:
        day: MJD.
        table: "1800-2050" or "3000BC-3000AD"; static.

    Raises:
        ValueError: the table is unknown.
    """
    if table not in TABLES:
        raise ValueError(f"table: expected one of {', '.join(TABLES)}, got {table!r}")
    first, last = _INTERVALS[table]
    day = jnp.asarray(day)
    return jnp.where(day < first, 1, jnp.where(day > last, 2, 0)).astype(jnp.int32)


def planet_state(body: str, day: Scalar, seconds: Scalar, table: str = "1800-2050") -> Vector6:
    """Heliocentric position and velocity of a planet [m, m/s], EME2000: the velocity is the position's derivative.

    Args:
        body, day, seconds, table: as in `planet_position`.

    Validity: as `planet_position`.
    """
    dtype = float_dtype(day, seconds)
    seconds = jnp.asarray(seconds, dtype)
    at = lambda seconds: planet_position(body, day, seconds, table)
    return jnp.concatenate(jax.jvp(at, (seconds,), (jnp.ones((), dtype),)))


def planet_position_geocentric(body: str, day: Scalar, seconds: Scalar, table: str = "1800-2050") -> Vector3:
    """Geocentric position of a planet [m], EME2000, geometric.

    Args:
        body, day, seconds, table: as in `planet_position`.

    Validity: as `planet_position`, of the body and of the Earth together.
    """
    return planet_position(body, day, seconds, table) - planet_position("earth", day, seconds, table)


def _keplerian(body, day, seconds, table) -> Vector3:
    (a, e, inclination, longitude, perihelion, node), rates = _TABLES[table][body]
    t = centuries_tt(day, seconds)
    a, e = (a + rates[0] * t) * c.AU, e + rates[1] * t
    inclination, perihelion_now, node = (
        jnp.deg2rad(x + rate * t) for x, rate in ((inclination, rates[2]), (perihelion, rates[4]), (node, rates[5]))
    )
    # `phase` counts whole turns exactly, also in float32; it takes TAI - UTC to be 37 s.
    tick = seconds + (tai_minus_utc(day, seconds) - c.TAI_MINUS_UTC)
    anomaly = phase(day, tick, longitude - perihelion, rates[3] - rates[4])
    if table == "3000BC-3000AD" and body in _ANOMALY:
        b, cosine, sine, f = _ANOMALY[body]
        angle = jnp.deg2rad(f * t)
        anomaly = anomaly + jnp.deg2rad(b * t * t + cosine * jnp.cos(angle) + sine * jnp.sin(angle))
    x, y = _ellipse(a, e, anomaly)
    argument = perihelion_now - node
    cos_w, sin_w, cos_n, sin_n = jnp.cos(argument), jnp.sin(argument), jnp.cos(node), jnp.sin(node)
    u, v = x * cos_w - y * sin_w, x * sin_w + y * cos_w  # from the node, and across it in the orbit
    across, z = v * jnp.cos(inclination), v * jnp.sin(inclination)
    x, y = u * cos_n - across * sin_n, u * sin_n + across * cos_n
    cos, sin = math.cos(_OBLIQUITY), math.sin(_OBLIQUITY)
    return jnp.stack([x, y * cos - z * sin, y * sin + z * cos])


def _ellipse(a, e, anomaly):
    """Coordinates in the orbit's plane, x to perihelion; four Newton steps are exact for eccentricities below 0.3."""
    eccentric = anomaly + e * jnp.sin(anomaly)
    for _ in range(4):
        sin, cos = jnp.sin(eccentric), jnp.cos(eccentric)
        eccentric = eccentric - (eccentric - e * sin - anomaly) / (1.0 - e * cos)
    return a * (jnp.cos(eccentric) - e), a * jnp.sqrt(1.0 - e * e) * jnp.sin(eccentric)
