"""SGP4 and SDP4: the analytic theory that two-line elements are made for, near Earth and in deep space."""
from astrojax.orbits.sgp4.elements import Sgp4Elements, is_deep_space, stack_elements
from astrojax.orbits.sgp4.propagation import STATUS, sgp4
from astrojax.orbits.sgp4.satellite import Sgp4Satellite, sgp4_init
