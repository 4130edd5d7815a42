"""Gravity of a body of even density bounded by triangles: an asteroid, a comet, any closed mesh."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from astrojax._types import FloatScalar, Scalar, Vector3
from astrojax.forces.base import Traced, force, static, turned, turned_back
from astrojax.forces.environment import Environment
from astrojax.forces.spacecraft import Spacecraft

GRAVITATIONAL_CONSTANT = 6.67430e-11  # CODATA 2018 [m^3/(kg s^2)]


@force
class Polyhedron:
    """A closed triangle mesh, ready for the sums over its faces and edges; made by `polyhedron`.

    Args:
        corners: (F, 3, 3) of each face, counterclockwise from outside [m].
        face_normals: (F, 3) unit, outward.
        ends: (E, 2, 3) of each edge [m].
        edge_dyads: (E, 3, 3) sum over its two faces of normal times edge normal.
    """

    corners: Traced
    face_normals: Traced
    ends: Traced
    edge_dyads: Traced

    @property
    def volume(self) -> FloatScalar:
        """Enclosed volume [m^3]."""
        a, b, c = self.corners[:, 0], self.corners[:, 1], self.corners[:, 2]
        return jnp.sum(a * jnp.cross(b, c)) / 6.0


def polyhedron(vertices: np.ndarray, faces: np.ndarray) -> Polyhedron:
    """A mesh as the gravity of a polyhedron needs it, on the host.

    Args:
        vertices: (V, 3) positions [m], as of `trimesh.Trimesh.vertices`.
        faces: (F, 3) indices of vertices, counterclockwise seen from outside.

    Raises: ValueError, the arrays have other shapes, an index is out of range, a face has no area, an edge does not
    have exactly two faces that run along it in opposite directions, or the faces are inside out.
    """
    vertices, faces = np.asarray(vertices, float), np.asarray(faces)
    if vertices.ndim != 2 or vertices.shape[1] != 3 or not np.isfinite(vertices).all():
        raise ValueError(f"vertices: expected finite numbers of shape (V, 3), got shape {vertices.shape}")
    if faces.ndim != 2 or faces.shape[1] != 3 or not np.issubdtype(faces.dtype, np.integer):
        raise ValueError(f"faces: expected integers of shape (F, 3), got {faces.dtype} of shape {faces.shape}")
    if faces.size == 0 or faces.min() < 0 or faces.max() >= len(vertices):
        raise ValueError(f"faces: expected indices from 0 to {len(vertices) - 1}")
    corners = vertices[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(areas, axis=1)
    if (sizes == 0).any():
        raise ValueError(f"faces: number {int(np.argmin(sizes))} has no area")
    if np.sum(corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])) <= 0:
        raise ValueError("faces: expected corners counterclockwise from outside, got a mesh inside out")
    normals = areas / sizes[:, None]
    sides = {(int(a), int(b)): i for i, face in enumerate(faces) for a, b in zip(face, np.roll(face, -1))}
    lone = [edge for edge in sides if edge[::-1] not in sides]
    if lone or len(sides) != faces.size:
        raise ValueError(
            "faces: expected a closed mesh, each edge once in either direction; "
            + (f"between vertices {lone[0]} it is not" if lone else "an edge is used twice in one direction")
        )
    edges = [edge for edge in sides if edge[0] < edge[1]]
    ends = vertices[np.array(edges)]
    dyads = np.zeros((len(edges), 3, 3))
    for i, (a, b) in enumerate(edges):
        along = vertices[b] - vertices[a]
        along /= np.linalg.norm(along)
        for face, direction in ((sides[a, b], along), (sides[b, a], -along)):
            dyads[i] += np.outer(normals[face], np.cross(direction, normals[face]))
    return Polyhedron(corners, normals, ends, dyads)


def _sums(r: Vector3, body: Polyhedron) -> tuple[Array, ...]:
    """To each face and edge: the vector from r, the solid angle, the edge's potential."""
    dtype = r.dtype
    corners, ends = (jnp.asarray(points, dtype) - r[None, None] for points in (body.corners, body.ends))
    lengths = jnp.sqrt(jnp.sum(corners * corners, axis=-1))
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = lengths[:, 0], lengths[:, 1], lengths[:, 2]
    triple = jnp.sum(a * jnp.cross(b, c), axis=-1)
    denominator = (
        la * lb * lc + la * jnp.sum(b * c, axis=-1) + lb * jnp.sum(c * a, axis=-1) + lc * jnp.sum(a * b, axis=-1)
    )
    angle = 2.0 * jnp.arctan2(triple, denominator)
    one, two = ends[:, 0], ends[:, 1]
    along = two - one
    length = jnp.sqrt(jnp.sum(along * along, axis=-1))
    around = jnp.sqrt(jnp.sum(one * one, axis=-1)) + jnp.sqrt(jnp.sum(two * two, axis=-1))
    # ln((a + b + e) / (a + b - e)), without the cancellation far away
    edge = 2.0 * jnp.arctanh(length / around)
    return a, one, angle, edge


def potential_polyhedron(
    r: Vector3, body: Polyhedron, density: Scalar, gravitational_constant: Scalar = GRAVITATIONAL_CONSTANT
) -> FloatScalar:
    """Potential [m^2/s^2] of a polyhedron of even density, positive, growing towards it.

    Args:
        r: (3,) position in the body's axes [m].
        body: from `polyhedron`.
        density: [kg/m^3].
        gravitational_constant: G [m^3/(kg s^2)].

    Validity: inside and outside, but for edges and corners themselves. Each term is of the size of the body's own
    field: at a distance of d body sizes d^2 of the precision is lost.

    Source: Werner and Scheeres 1996, Celestial Mechanics and Dynamical Astronomy 65, 313, eq. 10.
    """
    face, edge, angle, potential = _sums(r, body)
    normals, dyads = jnp.asarray(body.face_normals, r.dtype), jnp.asarray(body.edge_dyads, r.dtype)
    height = jnp.sum(normals * face, axis=-1)
    edges = jnp.sum(jnp.einsum("ei,eij,ej->e", edge, dyads, edge) * potential)
    return 0.5 * gravitational_constant * density * (edges - jnp.sum(height * height * angle))


def accel_polyhedron(
    r: Vector3, body: Polyhedron, density: Scalar, gravitational_constant: Scalar = GRAVITATIONAL_CONSTANT
) -> Vector3:
    """Acceleration [m/s^2] by a polyhedron of even density; arguments and validity as of `potential_polyhedron`.

    Source: Werner and Scheeres 1996, eq. 15.
    """
    face, edge, angle, potential = _sums(r, body)
    normals, dyads = jnp.asarray(body.face_normals, r.dtype), jnp.asarray(body.edge_dyads, r.dtype)
    height = jnp.sum(normals * face, axis=-1)
    edges = jnp.einsum("e,eij,ej->i", potential, dyads, edge)
    return gravitational_constant * density * ((height * angle) @ normals - edges)


def solid_angle_polyhedron(r: Vector3, body: Polyhedron) -> FloatScalar:
    """Solid angle [sr] that the surface covers, seen from r: 4 pi inside, 0 outside, either on a face.

    Minus G times the density times it is the Laplacian of the potential, so it tells whether r is inside.

    Source: Werner and Scheeres 1996, eq. 17.
    """
    return jnp.sum(_sums(r, body)[2])


@force
class PolyhedralGravity:
    """All of the attraction of a polyhedron, its central term included: it stands in place of `PointMass`.

    Args:
        body: from `polyhedron`.
        density: [kg/m^3].
        gravitational_constant: G [m^3/(kg s^2)].
        rotating: static; whether the environment's rotation turns inertial axes into the body's (give it), else they
            are the same.
    """

    body: Traced
    density: Traced
    gravitational_constant: Traced = GRAVITATIONAL_CONSTANT
    rotating: bool = static(default=True)

    @property
    def needs(self) -> frozenset[str]:
        return frozenset({"rotation"} if self.rotating else ())

    def acceleration_field(self, environment: Environment) -> Callable[[Float[Array, "3"]], Float[Array, "3"]]:
        """The acceleration [m/s^2] as a function of the inertial position [m] alone."""

        def fixed(r):
            return accel_polyhedron(r, self.body, self.density, self.gravitational_constant)

        if not self.rotating:
            return fixed
        rotation = environment.required("rotation", "PolyhedralGravity")
        return lambda r: turned_back(rotation, fixed(turned(rotation, r)))

    def accel(self, t: Scalar, r: Vector3, v: Vector3, spacecraft: Spacecraft, environment: Environment) -> Vector3:
        """Inertial acceleration [m/s^2]."""
        return self.acceleration_field(environment)(r)
