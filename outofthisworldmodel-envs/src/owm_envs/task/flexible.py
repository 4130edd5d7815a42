"""What swings in or on the chaser and pulls at it: fuel that sloshes, arrays that bend.

Fuel is a mass on three springs at the centre of mass, arrays are an inertia on a spring about each body axis. Each of
the six is a damped oscillator that the chaser drags along, the linear model of slosh and of a first bending mode
(Sidi (1997), Spacecraft Dynamics and Control, ch. 10). Momentum is exchanged, never made.

Not modelled: tanks beside the centre of mass, modes above the first, forces other than the thrusters' as a drive, the
springs' turning with the body.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from owm_envs.config.params import ChaserParams


class Swing(NamedTuple):
    """What swings against the body, along and about its axes."""

    place: Float[Array, "6"]
    """m and rad, body axes."""
    rate: Float[Array, "6"]
    """m/s and rad/s."""


def swing(
    chaser: ChaserParams, state: Swing, wrench: Float[Array, "6"], dt: Float[Array, ""]
) -> tuple[Swing, Float[Array, "6"]]:
    """One step of `dt` seconds under a constant wrench: the next state, and the mean wrench with which it pulls.

    The oscillators are solved exactly. A load's place in the body obeys q'' = -w / b - (1 + r) (W^2 q + 2 z W q'):
    b is the body's mass or moment, r the load's over it, W its frequency on a body held fast, z its damping.

    Args:
        wrench: of the thrusters, N and N m, body axes.
    """
    body = jnp.concatenate([jnp.full(3, chaser.mass), jnp.diag(chaser.inertia)])
    load, frequency, damping = chaser.flexible
    share = load / body
    drive = wrench / body
    decay = (1 + share) * damping * frequency
    stiffness = (1 + share) * frequency**2
    pace = jnp.sqrt(jnp.maximum(stiffness - decay**2, 1e-12))
    rest = -drive / stiffness
    left, cosine, sine = jnp.exp(-decay * dt), jnp.cos(pace * dt), jnp.sin(pace * dt) / pace
    away = state.place - rest
    place = rest + left * (away * cosine + (state.rate + decay * away) * sine)
    rate = left * (state.rate * cosine - (stiffness * away + decay * state.rate) * sine)
    impulse = -load * (rate - state.rate + drive * dt) / (1 + share)
    return Swing(place, rate), impulse / dt
