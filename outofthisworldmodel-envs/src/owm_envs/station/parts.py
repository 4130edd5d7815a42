"""What the station is made of: one table of parts, from which hull, mesh and pictures come.

The station of February to May 2015 without visiting vehicles, but with Leonardo at Tranquility's forward port
(its place since 27 May 2015), so that Unity's nadir port is free. Handrails, small antennas and cables are left out.
Frame: +x port side, +y aft, +z zenith, metres. Lengths and diameters of modules are published; places follow from
the mating planes of the eight ports and from the extents quoted for truss and arrays; poses of what moves are chosen.
Each row says which of these its figures are.
"""

from owm_envs.station.modules import MODULES
from owm_envs.station.primitives import MATERIALS, Material, Part
from owm_envs.station.truss import TRUSS

PARTS: tuple[Part, ...] = (*MODULES, *TRUSS)

__all__ = ["MATERIALS", "PARTS", "Material", "Part"]
