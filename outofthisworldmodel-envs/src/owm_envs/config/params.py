"""The traced numbers of a docking environment: every leaf may be swept, vmapped or differentiated."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, PyTree

from astrojax.time import mjd_from_calendar
from owm_envs.config.docking import DockingConfig
from owm_envs.station import PORT_NAMES, goal_poses, hull_boxes, port_index
from owm_envs.station.ports import docked_attitude


class ChiefParams(NamedTuple):
    """The station: elements [a m, e, i, raan, argp, M rad] at `epoch` [MJD day, s of day] UTC; kg, m2, -."""

    epoch: Float[Array, "2"]
    elements: Float[Array, "6"]
    drift: Float[Array, ""]
    """1 to let J2 turn the orbit from `epoch` to an episode's start, 0 for the same ellipse ever after."""
    mass: Float[Array, ""]
    drag_area: Float[Array, ""]
    drag_coefficient: Float[Array, ""]


class FaultParams(NamedTuple):
    """What goes wrong with the thrusters, and when: s, -, -, N and N m, rad; as in `FaultConfig`."""

    time: Float[Array, ""]
    thrust_scale: Float[Array, "6"]
    one_sided: Int[Array, "6"]
    leak: Float[Array, "6"]
    misalignment: Float[Array, "3"]


class FlexibleParams(NamedTuple):
    """What swings along and about the body axes: kg and kg m2, rad/s, -; as in `FlexibleConfig`."""

    load: Float[Array, "6"]
    frequency: Float[Array, "6"]
    damping: Float[Array, "6"]


class PlumeParams(NamedTuple):
    """How plumes push back from the hull: -, m; as in `PlumeConfig`."""

    strength: Float[Array, ""]
    reach: Float[Array, ""]


class ChaserParams(NamedTuple):
    """The chaser: kg, kg m2 about body axes, m2, m, N and N m, s, simulation steps; as in `ChaserConfig`."""

    mass: Float[Array, ""]
    inertia: Float[Array, "3 3"]
    drag_area: Float[Array, ""]
    drag_coefficient: Float[Array, ""]
    radius: Float[Array, ""]
    wrench_limit: Float[Array, "6"]
    thrust_scale: Float[Array, "6"]
    misalignment: Float[Array, "3"]
    actuation_delay: Int[Array, ""]
    """At most `Structure.longest_delay`."""
    delay_growth: Float[Array, ""]
    sag_time: Float[Array, ""]
    thruster_quantum: Float[Array, "6"]
    minimum_on_time: Float[Array, ""]
    hysteresis: Float[Array, ""]
    flexible: FlexibleParams
    """Unused unless `Structure.flexible`."""
    plume: PlumeParams
    """Unused unless `Structure.plume`."""
    fault: FaultParams | None
    """None unless `Structure.faulty`."""


class BiasParams(NamedTuple):
    """Total root-mean-square errors and correlation time, as in `BiasConfig`; unused where that has no size."""

    position: Float[Array, ""]
    velocity: Float[Array, ""]
    attitude: Float[Array, ""]
    rate: Float[Array, ""]
    correlation_time: Float[Array, ""]


class NoiseParams(NamedTuple):
    """Total root-mean-square errors, as in `NoiseConfig`."""

    position: Float[Array, ""]
    position_per_range: Float[Array, ""]
    velocity: Float[Array, ""]
    attitude: Float[Array, ""]
    rate: Float[Array, ""]
    bias: BiasParams


class NavigationParams(NamedTuple):
    """What goes wrong with relative navigation: s, -, -, -; as in `NavigationConfig`."""

    outage_duration: Float[Array, ""]
    outage_share: Float[Array, ""]
    outlier_share: Float[Array, ""]
    outlier_scale: Float[Array, ""]


class ResetParams(NamedTuple):
    """Bounds of the start distribution: m, rad, m/s, rad/s, s."""

    radius_min: Float[Array, ""]
    radius_max: Float[Array, ""]
    attitude_error: Float[Array, ""]
    speed: Float[Array, ""]
    rate: Float[Array, ""]
    epoch_window: Float[Array, ""]


class DockingParams(NamedTuple):
    """Docking tolerances: m, m/s, rad, rad/s."""

    position: Float[Array, ""]
    speed: Float[Array, ""]
    attitude: Float[Array, ""]
    rate: Float[Array, ""]


class RandomizationParams(NamedTuple):
    """Ranges (low, high) of an episode's draws, as in `RandomizationConfig`; unused while that is not active."""

    mass_scale: Float[Array, "2"]
    inertia_scale: Float[Array, "2"]
    thrust_scale: Float[Array, "2"]
    misalignment: Float[Array, "2"]
    """rad."""
    actuation_delay: Int[Array, "2"]
    fault_time: Float[Array, "2"]
    fault_scale: Float[Array, "2"]
    fault_misalignment: Float[Array, "2"]
    """rad."""
    target_rate: Float[Array, "2"]
    """rad/s."""
    chief_elements: Float[Array, "6 2"]
    """[m, -, rad, rad, rad, rad]."""


class Params(NamedTuple):
    """All of an environment's numbers."""

    dt: Float[Array, ""]
    horizon_steps: Int[Array, ""]
    """Actions in an episode."""
    escape_radius: Float[Array, ""]
    hull: Float[Array, "N 2 3"]
    """Keep-out boxes of the station: lower and upper corners, station frame, m."""
    obstacles: Float[Array, "M 2 3"]
    goals: Float[Array, "P 7"]
    """Hold pose of each port: position m, quaternion body to station."""
    port_choices: Int[Array, "C"]
    """Ports that may be assigned: the first `port_count`, each as likely."""
    port_count: Int[Array, ""]
    chief: ChiefParams
    chaser: ChaserParams
    noise: NoiseParams
    target_rate: Float[Array, "3"]
    """rad/s, in its own axes; as in `TargetConfig`."""
    reset: ResetParams
    docking: DockingParams
    reward: dict[str, Float[Array, ""]]
    randomization: RandomizationParams
    sensors: dict[str, PyTree] = {}  # noqa: RUF012 - never changed; a pytree without leaves
    """Of the sensors that have numbers of their own, by name: the scene and camera behind pixels."""
    navigation: NavigationParams | None = None
    """None unless `Structure.quiet` or `heavy_tailed`."""


def goals_of(config: DockingConfig) -> Float[np.ndarray, "8 7"]:
    """Hold poses of a configuration's ports: m, quaternion body to station; all the same where its target has one."""
    hold = config.target.hold
    if hold is None:
        return goal_poses()
    outwards = np.asarray(hold, np.float64) / np.linalg.norm(hold)
    return np.tile(np.concatenate([hold, docked_attitude(outwards)]), (len(PORT_NAMES), 1))


def hull_of(config: DockingConfig) -> Float[np.ndarray, "N 2 3"]:
    """Keep-out boxes of a configuration: lower and upper corners, m."""
    return hull_boxes() if config.hull == "iss" else np.asarray(config.hull, np.float64)


def params_from_config(config: DockingConfig) -> Params:
    """Lay a configuration out as arrays of its precision.

    Raises:
        RuntimeError: the precision is float64 and JAX's 64-bit mode is off.
    """
    dtype = np.dtype(config.precision)
    if jnp.zeros((), jnp.result_type(float)).dtype != np.float64 and dtype == np.float64:
        raise RuntimeError(
            f"{config.fidelity!r} at precision 'float64' needs JAX's 64-bit mode: work inside "
            "`with jax.enable_x64(True):` (the Gymnasium adapters do so by themselves)"
        )

    def real(value) -> jax.Array:
        return jnp.asarray(value, dtype)

    chief, chaser, noise, ranges = config.chief, config.chaser, config.noise, config.randomization
    flexible = chaser.flexible
    ports = [port_index(name) for name in config.ports]
    padding = [ports[0]] * (config.structure.port_slots - len(ports))
    angles = np.radians([chief.inclination_deg, chief.raan_deg, chief.argument_of_perigee_deg, chief.mean_anomaly_deg])
    spoiled = config.structure.quiet or config.structure.heavy_tailed
    return Params(
        dt=real(config.dt),
        horizon_steps=jnp.asarray(config.horizon_decisions, jnp.int32),
        escape_radius=real(config.escape_radius),
        hull=real(hull_of(config)),
        obstacles=real(np.asarray(config.obstacles, np.float64).reshape(-1, 2, 3)),
        goals=real(goals_of(config)),
        port_choices=jnp.asarray(ports + padding, jnp.int32),
        port_count=jnp.asarray(len(ports), jnp.int32),
        chief=ChiefParams(
            epoch=real(mjd_from_calendar(chief.reference_epoch)),
            elements=real([chief.semi_major_axis, chief.eccentricity, *angles]),
            drift=real(chief.secular_drift),
            mass=real(chief.mass),
            drag_area=real(chief.drag_area),
            drag_coefficient=real(chief.drag_coefficient),
        ),
        chaser=ChaserParams(
            mass=real(chaser.mass),
            inertia=real(np.diag(chaser.inertia)),
            drag_area=real(chaser.drag_area),
            drag_coefficient=real(chaser.drag_coefficient),
            radius=real(chaser.radius),
            wrench_limit=real([chaser.force_limit] * 3 + [chaser.torque_limit] * 3),
            thrust_scale=real(chaser.thrust_scale),
            misalignment=real(chaser.misalignment),
            actuation_delay=jnp.asarray(chaser.actuation_delay, jnp.int32),
            delay_growth=real(chaser.delay_growth),
            sag_time=real(chaser.sag_time),
            thruster_quantum=real([chaser.thruster_force] * 3 + [chaser.thruster_torque] * 3),
            minimum_on_time=real(chaser.minimum_on_time),
            hysteresis=real(chaser.hysteresis),
            flexible=FlexibleParams(
                load=real([flexible.slosh_mass] * 3 + [flexible.array_inertia] * 3),
                frequency=real(2 * np.pi * np.repeat([flexible.slosh_frequency, flexible.array_frequency], 3)),
                damping=real([flexible.slosh_damping] * 3 + [flexible.array_damping] * 3),
            ),
            plume=PlumeParams(strength=real(chaser.plume.strength), reach=real(chaser.plume.reach)),
            fault=None
            if not config.structure.faulty
            else FaultParams(
                time=real(chaser.fault.time),
                thrust_scale=real(chaser.fault.thrust_scale),
                one_sided=jnp.asarray(chaser.fault.one_sided, jnp.int32),
                leak=real(chaser.fault.leak),
                misalignment=real(chaser.fault.misalignment),
            ),
        ),
        noise=NoiseParams(
            **{name: real(value) for name, value in noise if name != "bias"},
            bias=BiasParams(**{name: real(value) for name, value in noise.bias}),
        ),
        target_rate=real(np.radians(config.target.rate_deg)),
        navigation=NavigationParams(**{name: real(value) for name, value in config.navigation}) if spoiled else None,
        reset=ResetParams(
            radius_min=real(config.reset.radius_min),
            radius_max=real(config.reset.radius_max),
            attitude_error=real(np.radians(config.reset.attitude_error_deg)),
            speed=real(config.reset.speed),
            rate=real(config.reset.rate),
            epoch_window=real(config.reset.epoch_window),
        ),
        docking=DockingParams(
            position=real(config.docking.position),
            speed=real(config.docking.speed),
            attitude=real(np.radians(config.docking.attitude_deg)),
            rate=real(np.radians(config.docking.rate_deg)),
        ),
        reward={name: real(value) for name, value in config.reward},
        randomization=RandomizationParams(
            mass_scale=real(ranges.mass_scale),
            inertia_scale=real(ranges.inertia_scale),
            thrust_scale=real(ranges.thrust_scale),
            misalignment=real(np.radians(ranges.misalignment_deg)),
            actuation_delay=jnp.asarray(ranges.actuation_delay, jnp.int32),
            fault_time=real(ranges.fault_time),
            fault_scale=real(ranges.fault_scale),
            fault_misalignment=real(np.radians(ranges.fault_misalignment_deg)),
            target_rate=real(np.radians(ranges.target_rate_deg)),
            chief_elements=real(
                [
                    ranges.chief_semi_major_axis,
                    ranges.chief_eccentricity,
                    np.radians(ranges.chief_inclination_deg),
                    np.radians(ranges.chief_raan_deg),
                    np.radians(ranges.chief_argument_of_perigee_deg),
                    np.radians(ranges.chief_mean_anomaly_deg),
                ]
            ),
        ),
    )
