"""SGP4 and SDP4: the analytic theory that two-line elements are made for, near Earth and in deep space.

Parse on the host (`read_tle`, `read_omm`), stack, then one program flies the catalogue:

    sets = read_tle(text)
    satellites = jax.jit(jax.vmap(sgp4_init))(stack_elements([s.elements for s in sets]))
    position, velocity, status = jax.jit(jax.vmap(sgp4))(satellites, minutes)
"""

from astrojax.orbits.sgp4.element_set import ElementSet, alpha5_to_number, number_to_alpha5
from astrojax.orbits.sgp4.elements import Sgp4Elements, is_deep_space, stack_elements
from astrojax.orbits.sgp4.omm import read_omm
from astrojax.orbits.sgp4.propagation import STATUS, sgp4
from astrojax.orbits.sgp4.satellite import Sgp4Satellite, sgp4_init
from astrojax.orbits.sgp4.tle import parse_tle, read_tle

__all__ = [
    "STATUS",
    "ElementSet",
    "Sgp4Elements",
    "Sgp4Satellite",
    "alpha5_to_number",
    "is_deep_space",
    "number_to_alpha5",
    "parse_tle",
    "read_omm",
    "read_tle",
    "sgp4",
    "sgp4_init",
    "stack_elements",
]
