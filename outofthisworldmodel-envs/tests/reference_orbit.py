"""Independent flights of station and chaser to hold `iss-numerical` against; nothing here uses astrojax or owm_envs.

The same forces twice: written out in NumPy, with ERFA's Sun and Moon, and integrated by SciPy's DOP853; and brahe's,
under its own integrator. Inertial states are [r m, v m/s]; a view is the 13-number station-relative one.
"""

from typing import NamedTuple

import brahe
import erfa
import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

from owm_envs.view import View

brahe.set_global_eop_provider_from_static_provider(brahe.StaticEOPProvider.from_zero())  # else it would download

GM, RADIUS = 3.986004415e14, 6378136.3
# EGM2008, fully normalised C_20, C_30, C_40.
ZONALS = {2: -4.84165143790815e-4, 3: 9.57161207093473e-7, 4: 5.39965866638991e-7}
GM_SUN, GM_MOON, AU = 1.32712440041e20, 4.9028001e12, 149597870700.0
EARTH_RATE = np.array([0.0, 0.0, 7.292115146706979e-5])
TT_MINUS_UTC = 69.184
# Montenbruck and Gill, table 3.8, the heights of the station: km, minimum and maximum density g/km3.
DENSITY = np.array(
    [(380, 3.274, 9.955), (400, 2.249, 7.492), (420, 1.558, 5.684), (440, 1.091, 4.355), (460, 0.7701, 3.362)]
)


class Vehicle(NamedTuple):
    """kg, m2, -, and principal moments of inertia kg m2."""

    mass: float
    area: float
    cd: float
    inertia: np.ndarray = np.ones(3)


STATION = Vehicle(419_700.0, 1500.0, 2.2)
CHASER = Vehicle(12_000.0, 50.0, 2.2, np.array([80_000.0, 80_000.0, 50_000.0]))


def chief_state(elements, seconds):
    """Inertial state `seconds` of two-body motion after osculating elements [a m, e, i, raan, argp, M rad]."""
    moved = np.array(elements, float)
    moved[5] = (moved[5] + np.sqrt(GM / moved[0] ** 3) * seconds) % (2 * np.pi)
    return brahe.state_koe_to_eci(moved, brahe.AngleFormat.RADIANS)


def potential(r, degrees=ZONALS):
    """Gravitational potential energy per kg [J/kg] at (..., 3), real or complex."""
    inverse = 1 / np.sqrt((r * r).sum(-1))
    total = 1.0
    for n in degrees:
        coefficients = np.zeros(n + 1)
        coefficients[n] = np.sqrt(2 * n + 1) * ZONALS[n]
        total = total + (RADIUS * inverse) ** n * np.polynomial.legendre.legval(r[..., 2] * inverse, coefficients)
    return -GM * inverse * total


def gravity(r, degrees=ZONALS):
    """Acceleration (3,), the complex-step gradient of the potential."""
    step = 1e-15 * RADIUS
    return -potential(r + 1j * step * np.eye(3), degrees).imag / step


def bodies(day, seconds):
    """Geocentric Sun and Moon (3,) [m] at a UTC epoch, from ERFA's full series."""
    date, fraction = 2400000.5 + day, (seconds + TT_MINUS_UTC) / 86400.0
    earth, _ = erfa.epv00(date, fraction)
    return -earth["p"] * AU, erfa.moon98(date, fraction)["p"] * AU


def third_body(r, body, gm):
    """Direct minus indirect attraction (3,)."""
    apart = body - r
    return gm * (apart / np.linalg.norm(apart) ** 3 - body / np.linalg.norm(body) ** 3)


def density(r, sun):
    """Harris-Priester density [kg/m3], exponent 6."""
    height = erfa.gc2gd(1, r)[2] / 1e3
    i = int(np.searchsorted(DENSITY[:, 0], height)) - 1
    (low, *rho_low), (high, *rho_high) = DENSITY[i : i + 2]
    scale_heights = (high - low) / np.log(np.divide(rho_low, rho_high))
    night, day = rho_low * np.exp((low - height) / scale_heights)
    apex = Rotation.from_rotvec([0, 0, np.radians(30)]).apply(sun / np.linalg.norm(sun))
    psi = np.arccos(apex @ r / np.linalg.norm(r))
    return 1e-12 * (night + (day - night) * np.cos(psi / 2) ** 6)


def acceleration(state, heavens, vehicle):
    """All forces but thrust (3,) [m/s2], with the Sun and the Moon of `bodies`."""
    r, v = state[:3], state[3:]
    sun, moon = heavens
    wind = v - np.cross(EARTH_RATE, r)
    drag = -0.5 * density(r, sun) * vehicle.cd * vehicle.area / vehicle.mass * np.linalg.norm(wind) * wind
    return gravity(r) + third_body(r, sun, GM_SUN) + third_body(r, moon, GM_MOON) + drag


def station_frame(chief, accel):
    """Station axes as rows (3, 3), and their angular rate in those axes, from the axes' own derivatives."""
    r, v = chief[:3], chief[3:]
    h, h_dot = np.cross(r, v), np.cross(r, accel)

    def unit(vector, rate):
        direction = vector / np.linalg.norm(vector)
        return direction, (rate - direction * (direction @ rate)) / np.linalg.norm(vector)

    (normal, normal_dot), (zenith, zenith_dot) = unit(h, h_dot), unit(r, v)
    aft = np.cross(zenith, normal)
    aft_dot = np.cross(zenith_dot, normal) + np.cross(zenith, normal_dot)
    axes, rates = np.array([normal, aft, zenith]), np.array([normal_dot, aft_dot, zenith_dot])
    return axes, axes @ (np.cross(axes, rates).sum(0) / 2)


def rotation(quaternion):
    """SciPy rotation of a scalar-first quaternion."""
    return Rotation.from_quat(np.roll(quaternion, -1))


def to_inertial(chief, accel, view):
    """Orbit (6,), attitude (rotation body to inertial) and inertial body rate (3,) of a chaser seen as `view` (13,)."""
    axes, rate = station_frame(chief, accel)
    seen = View.of(view)
    attitude = rotation(seen.attitude)
    moved = np.stack([seen.position, seen.velocity + np.cross(rate, seen.position)]) @ axes
    return chief + moved.ravel(), Rotation.from_matrix(axes.T) * attitude, seen.rate + attitude.inv().apply(rate)


def euler(rate, attitude, r, torque, vehicle):
    """Angular acceleration (3,) in body axes under a body torque and the gravity gradient."""
    down = attitude.inv().apply(r)
    gradient = 3 * GM / np.linalg.norm(r) ** 5 * np.cross(down, vehicle.inertia * down)
    return (torque + gradient - np.cross(rate, vehicle.inertia * rate)) / vehicle.inertia


def fly_scipy(epoch, chief, view, wrenches, duration):
    """Both vehicles after each of the wrenches (K, 6), held for `duration` s: K of (chief, orbit, attitude, rate)."""
    day, seconds = epoch
    orbit, attitude, rate = to_inertial(chief, acceleration(chief, bodies(day, seconds), STATION), view)
    y = np.concatenate([chief, orbit, attitude.as_matrix().ravel(), rate])
    # The attitude is a direction cosine matrix here: no quaternion to share a mistake with.
    tolerance = np.repeat([1e-8, 1e-11, 1e-8, 1e-11, 1e-13], [3, 3, 3, 3, 12])
    ends = []
    for k, wrench in enumerate(wrenches):

        def derivative(t, y, wrench=wrench):
            matrix, rate = y[12:21].reshape(3, 3), y[21:]
            heavens = bodies(day, seconds + t)
            thrust = matrix @ wrench[:3] / CHASER.mass
            turn = matrix @ np.cross(np.eye(3), rate)  # R [w]x, since e_i x w are the rows of its matrix
            return np.concatenate(
                [
                    y[3:6],
                    acceleration(y[:6], heavens, STATION),
                    y[9:12],
                    acceleration(y[6:12], heavens, CHASER) + thrust,
                    turn.ravel(),
                    euler(rate, Rotation.from_matrix(matrix), y[6:9], wrench[3:], CHASER),
                ]
            )

        span = (k * duration, (k + 1) * duration)
        y = solve_ivp(derivative, span, y, method="DOP853", rtol=1e-12, atol=tolerance).y[:, -1]
        ends.append((y[:6], y[6:12], Rotation.from_matrix(y[12:21].reshape(3, 3)), y[21:]))
    return ends


def _brahe_forces(vehicle):
    value = brahe.ParameterSource.value
    return brahe.ForceModelConfig(
        gravity=brahe.GravityConfiguration.earth_zonal(brahe.ZonalHarmonicsDegree.J4),
        drag=brahe.DragConfiguration(
            model=brahe.AtmosphericModel.HARRIS_PRIESTER, area=value(vehicle.area), cd=value(vehicle.cd)
        ),
        third_body=[
            brahe.ThirdBodyConfiguration(body, brahe.EphemerisSource.LowPrecision)
            for body in (brahe.ThirdBody.SUN, brahe.ThirdBody.MOON)
        ],
        mass=value(vehicle.mass),
        frame_transform=brahe.FrameTransformationModel.EARTH_ROTATION_ONLY,
    )


def fly_brahe(epoch, chief, view, wrenches, duration):
    """As `fly_scipy`, by brahe: the chaser's quaternion and rate are extra states, its thrust a control input."""
    day, seconds = epoch
    orbit, attitude, rate = to_inertial(chief, acceleration(chief, bodies(day, seconds), STATION), view)
    start = brahe.Epoch.from_mjd(day, brahe.TimeSystem.UTC) + seconds
    config = brahe.NumericalPropagationConfig.with_method(brahe.IntegrationMethod.RKF78)
    config = config.with_abs_tol(1e-9).with_rel_tol(1e-13).with_initial_step(1.0)
    held = np.zeros(6)

    def turning(t, y, _):
        q, w = y[6:10], y[10:]  # scalar last
        q_dot = 0.5 * np.append(q[3] * w + np.cross(q[:3], w), -q[:3] @ w)
        return np.concatenate([np.zeros(6), q_dot, euler(w, Rotation.from_quat(q), y[:3], held[3:], CHASER)])

    def thrust(t, y, _):
        accel = Rotation.from_quat(y[6:10]).apply(held[:3]) / CHASER.mass
        return np.concatenate([np.zeros(3), accel, np.zeros(7)])

    station = brahe.NumericalOrbitPropagator(start, chief, config, _brahe_forces(STATION))
    y = np.concatenate([orbit, attitude.as_quat(), rate])
    chaser = brahe.NumericalOrbitPropagator(start, y, config, _brahe_forces(CHASER), None, None, turning, thrust)
    ends = []
    for k, wrench in enumerate(wrenches):
        held[:] = wrench
        for vehicle in (station, chaser):
            vehicle.propagate_to(start + (k + 1) * duration)
        y = chaser.current_state()
        ends.append((station.current_state(), y[:6], Rotation.from_quat(y[6:10]), y[10:]))
    return ends


def station_relative(end, epoch, elapsed):
    """View (3 position, 3 velocity), rotation body to station and station-relative rate (3,) of a flown end."""
    chief, orbit, attitude, rate = end
    heavens = bodies(epoch[0], epoch[1] + elapsed)
    axes, frame_rate = station_frame(chief, acceleration(chief, heavens, STATION))
    position = axes @ (orbit[:3] - chief[:3])
    velocity = axes @ (orbit[3:] - chief[3:]) - np.cross(frame_rate, position)
    relative = Rotation.from_matrix(axes) * attitude
    return np.concatenate([position, velocity]), relative, rate - relative.inv().apply(frame_rate)
