"""What the thrusters make of a commanded wrench: late, in pulses, scaled and turned, failing in flight, as configured.

Valves with hysteresis follow a command only where it leaves a band about what they deliver (the play operator:
Visintin (1994), Differential Models of Hysteresis).

The delay may grow with thrust, as valves open later where the feed pressure sags. The sag is a first-order lag of the
thrust's share: of the limits, summed over the axes, at most 1. Between whole steps of delay commands are interpolated.
Where the delay grows faster than time goes by, older commands act again.

On-off thrusters deliver along each body axis a whole number of quanta, kept for at least the minimum on-time. Each
axis remembers the impulse it still owes. Whenever its last pulse is over, it chooses the level that would settle the
debt if the command stayed as it is for one pulse (first-order error feedback, as in a sigma-delta modulator), never
against the sign of the command. With q the quantum, P the pulse's length, dt the step and L the most quanta within
the limit, delivered and commanded impulse differ by at most q P / 2 at the ends of pulses while commands change only
there, and always by at most q P / 2 + 2 L q (P - dt). A command beyond L q counts as L q.

Not modelled: single thrusters with their places and couplings, rise and decay of thrust, a minimum off-time,
propellant. The gradient of an on-off wrench with respect to its command is zero.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from astrojax.attitude import quat_from_rotation_vector, quat_rotate
from owm_envs.config.docking import Structure
from owm_envs.config.params import ChaserParams, FaultParams
from owm_envs.task.flexible import Swing, swing
from owm_envs.task.plume import NearHull, thrown_back


class Pulses(NamedTuple):
    """On-off thrusters between two simulation steps, per axis of the wrench."""

    owed: Float[Array, "6"]
    """Commanded less delivered impulse, N s and N m s."""
    level: Float[Array, "6"]
    """Quanta being delivered."""
    left: Int[Array, "6"]
    """Simulation steps left of the pulse."""


class ActuatorState(NamedTuple):
    """What the thrusters carry from one simulation step to the next."""

    queue: Float[Array, "D 6"]
    """Commands still on their way, oldest first."""
    sag: Float[Array, ""] | None
    """Of the feed pressure, 0 to 1; None where the delay does not grow."""
    pulses: Pulses | None
    """Of on-off thrusters, None without."""
    elapsed: Float[Array, ""] | None
    """s since the episode's start; None where nothing ever fails."""
    valves: Float[Array, "6"] | None
    """What valves with hysteresis let through, N and N m; None without."""
    swing: Swing | None
    """Of what is not rigid, None without."""


def actuators_at_rest(structure: Structure, dtype: DTypeLike) -> ActuatorState:
    """No command on its way, no pulse begun, nothing that swings."""

    def none():
        return jnp.zeros(6, dtype)

    return ActuatorState(
        queue=jnp.zeros((structure.longest_delay, 6), dtype),
        sag=jnp.zeros((), dtype) if structure.sagging else None,
        pulses=Pulses(none(), none(), jnp.zeros(6, jnp.int32)) if structure.on_off else None,
        elapsed=jnp.zeros((), dtype) if structure.faulty else None,
        valves=none() if structure.sticky else None,
        swing=Swing(none(), none()) if structure.flexible else None,
    )


def deliver(
    chaser: ChaserParams,
    state: ActuatorState,
    wrench: Float[Array, "6"],
    dt: Float[Array, ""],
    near: NearHull | None = None,
) -> tuple[ActuatorState, Float[Array, "6"]]:
    """One simulation step of `dt` seconds: the next state, and the body wrench that acts during it.

    Args:
        wrench: command, N and N m, body axes.
        near: the hull that throws plumes back; None for none.
    """
    queue, sag = state.queue, state.sag
    longest = queue.shape[0]
    if longest:
        queue = jnp.concatenate([queue, wrench[None]])
        if sag is None:
            wrench = queue[longest - jnp.clip(chaser.actuation_delay, 0, longest)]
        else:
            delay = jnp.clip(chaser.actuation_delay + chaser.delay_growth * sag, 0, longest)
            whole = jnp.floor(delay).astype(jnp.int32)
            newer, older = queue[longest - whole], queue[jnp.maximum(longest - whole - 1, 0)]
            wrench = newer + (delay - whole) * (older - newer)
            flow = jnp.minimum(jnp.sum(jnp.abs(wrench) / chaser.wrench_limit), 1)
            sag = flow + (sag - flow) * jnp.exp(-dt / chaser.sag_time)
        queue = queue[1:]
    valves = state.valves
    if valves is not None:
        band = chaser.hysteresis * chaser.wrench_limit
        wrench = valves = jnp.clip(valves, wrench - band, wrench + band)
    pulses = state.pulses
    if pulses is not None:
        pulses = _pulse(chaser, pulses, wrench, dt)
        wrench = pulses.level * chaser.thruster_quantum
    delivered, elapsed = wrench * chaser.thrust_scale, state.elapsed
    if chaser.fault is not None:
        # A step in which the fault sets in counts as one before it.
        delivered = jnp.where(elapsed >= chaser.fault.time, _failed(chaser.fault, delivered), delivered)
        elapsed = elapsed + dt
    delivered, swinging = _turned(delivered, chaser.misalignment), state.swing
    if near is not None:
        delivered = delivered + thrown_back(near, delivered)
    if swinging is not None:
        swinging, pull = swing(chaser, swinging, delivered, dt)
        delivered = delivered + pull
    return ActuatorState(queue, sag, pulses, elapsed, valves, swinging), delivered


def _turned(wrench: Float[Array, "6"], by: Float[Array, "3"]) -> Float[Array, "6"]:
    turn = quat_from_rotation_vector(by)
    return jnp.concatenate([quat_rotate(turn, wrench[:3]), quat_rotate(turn, wrench[3:])])


def _failed(fault: FaultParams, wrench: Float[Array, "6"]) -> Float[Array, "6"]:
    """What a fault leaves of a wrench."""
    wrench = jnp.where(wrench * fault.one_sided < 0, 0, wrench) * fault.thrust_scale
    return _turned(wrench + fault.leak, fault.misalignment)


def _pulse(chaser: ChaserParams, pulses: Pulses, command: Float[Array, "6"], dt: Float[Array, ""]) -> Pulses:
    quantum = chaser.thruster_quantum
    # A little less than the ratio, so that an on-time of whole steps is not rounded up to one more.
    steps = jnp.maximum(jnp.ceil(chaser.minimum_on_time / dt - 1e-6), 1)
    most = jnp.floor(chaser.wrench_limit / quantum + 1e-6)
    command = jnp.clip(command, -most * quantum, most * quantum)
    wanted = jnp.round(pulses.owed / (quantum * steps * dt) + command / quantum)
    # Never against the command, and so nothing without one.
    wanted = jnp.clip(wanted, jnp.where(command < 0, -most, 0), jnp.where(command > 0, most, 0))
    idle = pulses.left == 0
    level = jnp.where(idle, wanted, pulses.level)
    left = jnp.where(idle, jnp.where(level == 0, 0, steps).astype(jnp.int32), pulses.left)
    return Pulses(pulses.owed + (command - level * quantum) * dt, level, jnp.maximum(left - 1, 0))
