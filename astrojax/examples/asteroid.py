"""Two orbits about a turning asteroid made of triangles: one flies with the rotation, one against it.

    pip install trimesh
    python astrojax/examples/asteroid.py --days 4 --out .

The picture, drawn with `--out`, needs matplotlib.
"""

import argparse
import functools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import trimesh

from astrojax import propagate
from astrojax.forces import (
    Environment,
    ForceModel,
    PolyhedralGravity,
    Spacecraft,
    accel_polyhedron,
    polyhedron,
    potential_polyhedron,
    solid_angle_polyhedron,
)
from astrojax.forces.polyhedral import GRAVITATIONAL_CONSTANT

HALF_AXES = (900.0, 600.0, 450.0)  # [m]
DENSITY = 2400.0  # [kg/m^3]
SPIN = 2.0 * math.pi / (9.0 * 3600.0)  # about the body's z axis [rad/s]
RADIUS = 1900.0  # of both orbits at the start [m]


class Flight(NamedTuple):
    """What is found on the way.

    Attributes:
        t: (S,) times [s] at which integration steps end; energy, jacobi: what is kept there, or not [m^2/s^2].
        angle: (S,) solid angle of the asteroid there [sr].
        track: (K, 3) position in the body's axes [m] at even times.
    """

    t: np.ndarray
    energy: np.ndarray
    jacobi: np.ndarray
    angle: np.ndarray
    track: np.ndarray


def ellipsoid(subdivisions: int) -> trimesh.Trimesh:
    """A closed convex mesh whose vertices lie on the ellipsoid."""
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return trimesh.Trimesh(sphere.vertices * np.array(HALF_AXES), sphere.faces, process=False)


def turned(t) -> jax.Array:
    """Rotation from inertial axes to the body's."""
    cos, sin = jnp.cos(SPIN * t), jnp.sin(SPIN * t)
    return jnp.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


@functools.partial(jax.jit, static_argnames=("max_steps", "samples"))
def fly(body, state, seconds, max_steps: int, samples: int):
    """Status and a `Flight`, integrated in inertial axes."""
    model = ForceModel((PolyhedralGravity(body, DENSITY),))

    def world(t):
        return Environment(rotation=turned(t))

    flight = (model.derivative, 0.0, state, seconds, Spacecraft(), world)
    path = propagate.trajectory(*flight, rtol=1e-11, atol=1e-7, max_steps=max_steps)

    def look(i):
        t, y = path.t[i], path.y[i]
        r, v = turned(t) @ y[:3], y[3:]
        energy = 0.5 * v @ v - potential_polyhedron(r, body, DENSITY)
        # In inertial axes the Jacobi constant is energy less spin times angular momentum.
        return t, energy, energy - SPIN * (y[0] * v[1] - y[1] * v[0]), solid_angle_polyhedron(r, body)

    def place(t):
        return turned(t) @ propagate.interpolate(path, t)[0][:3]

    kept = jax.lax.map(look, jnp.arange(samples) * path.steps // (samples - 1))
    return path.status, Flight(*kept, jax.vmap(place)(jnp.linspace(0.0, seconds, samples)))


def flights(body, days: float) -> dict[str, Flight]:
    """One orbit with the rotation and one against it, both circular if all mass were in the centre."""
    speed = math.sqrt(GRAVITATIONAL_CONSTANT * DENSITY * float(body.volume) / RADIUS)
    found = {}
    for name, sign in (("with the rotation", 1.0), ("against it", -1.0)):
        state = jnp.array([RADIUS, 0.0, 0.0, 0.0, sign * speed, 0.0])
        status, flight = fly(body, state, 86400.0 * days, max_steps=64 + int(1000 * days), samples=1000)
        assert status == propagate.SUCCESS, "raise max_steps"
        found[name] = jax.tree.map(np.asarray, flight)
    return found


class Field(NamedTuple):
    """At random points: whether inside by each face's plane, solid angle [sr], Laplacian of the potential [1/s^2]."""

    inside: np.ndarray
    angle: np.ndarray
    laplacian: np.ndarray


def field(mesh: trimesh.Trimesh, body, count: int, seed: int = 0) -> Field:
    """Two tests of inside and out, and the divergence of the attraction by automatic differentiation."""
    points = np.random.default_rng(seed).uniform(-1.3, 1.3, (count, 3)) * HALF_AXES
    away = np.einsum("pfi,fi->pf", points[:, None] - mesh.triangles_center, mesh.face_normals)

    @jax.jit
    def look(r):
        divergence = jnp.trace(jax.jacfwd(lambda r: accel_polyhedron(r, body, DENSITY))(r))
        return solid_angle_polyhedron(r, body), divergence

    angle, laplacian = jax.lax.map(look, jnp.asarray(points), batch_size=64)
    return Field((away < 0.0).all(axis=1), np.asarray(angle), np.asarray(laplacian))


def draw(mesh: trimesh.Trimesh, found: dict[str, Flight], file: Path) -> None:
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.6), layout="constrained")
    left.tripcolor(*mesh.vertices[:, :2].T / 1e3, mesh.faces, np.zeros(len(mesh.faces)), cmap="Greys", vmin=-1, vmax=1)
    for name, flight in found.items():
        (line,) = left.plot(*flight.track[:, :2].T / 1e3, lw=0.8, label=name)
        days = flight.t / 86400.0
        right.semilogy(days, np.abs(flight.energy / flight.energy[0] - 1.0) + 1e-17, lw=0.8, color=line.get_color())
        jacobi = np.abs(flight.jacobi / flight.jacobi[0] - 1.0) + 1e-17
        right.semilogy(days, jacobi, ":", lw=1.2, color=line.get_color())
    left.set(aspect="equal", xlabel="x [km], body axes", ylabel="y [km]")
    left.legend(loc="upper right", fontsize=8)
    right.plot([], [], "k-", label="energy")
    right.plot([], [], "k:", label="Jacobi constant")
    right.set(xlabel="days", ylabel="relative change", ylim=(1e-14, 10.0))
    right.legend()
    figure.savefig(file, dpi=130)
    plt.close(figure)


def main(arguments: Sequence[str] | None = None) -> tuple[dict[str, Flight], Field]:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--days", type=float, default=4.0)
    parser.add_argument("--subdivisions", type=int, default=3, help="of an icosahedron, each four times the faces")
    parser.add_argument("--points", type=int, default=2000, help="at which inside and outside are told apart")
    parser.add_argument("--out", type=Path, help="folder for the picture")
    options = parser.parse_args(arguments)
    mesh = ellipsoid(options.subdivisions)
    with jax.enable_x64(True):
        body = polyhedron(mesh.vertices, mesh.faces)
        found, seen = flights(body, options.days), field(mesh, body, options.points)
        share = float(body.volume) / (4.0 / 3.0 * math.pi * math.prod(HALF_AXES))
    print(f"{len(mesh.faces)} faces, {100 * share:.1f} % of the ellipsoid's volume")
    for name, flight in found.items():
        energy, jacobi = (np.ptp(x) / abs(x[0]) for x in (flight.energy, flight.jacobi))
        distance = np.linalg.norm(flight.track, axis=1)
        print(
            f"{name:17}: {distance.min():.0f} to {distance.max():.0f} m from the centre,\n"
            f"  energy varies by {100 * energy:.1f} %, Jacobi constant by {jacobi:.1g}"
        )
    told = (seen.angle > 2.0 * math.pi) == seen.inside
    poisson = -4.0 * math.pi * GRAVITATIONAL_CONSTANT * DENSITY
    wrong = np.abs(seen.laplacian / poisson - seen.inside).max()
    print(f"{told.sum()} of {len(told)} points told right, {seen.inside.sum()} of them inside")
    print(f"Laplacian: -4 pi G density inside and 0 outside, to {wrong:.1g} of it")
    if options.out:
        draw(mesh, found, options.out / "asteroid.png")
    return found, seen


if __name__ == "__main__":
    main()
