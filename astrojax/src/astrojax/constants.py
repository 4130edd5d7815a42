"""Physical constants as Python floats (SI), so that they take on the dtype of whatever they meet."""

import math

# Earth gravity field: EGM2008 (Pavlis et al. 2012, doi:10.1029/2011JB008916), tide-free. GM and R_EARTH are
# the scale factors the coefficients were published with, so the three belong together; GM differs from the
# IERS 2010 value (3.986004418e14, which includes the atmosphere) by 8e-10.
GM_EARTH = 3.986004415e14
"""Gravitational parameter of the Earth, of EGM2008 [m^3/s^2]."""
R_EARTH = 6378136.3
"""Radius that EGM2008 refers to [m]."""
# Unnormalised J_n = -sqrt(2 n + 1) * C_n0 of the published fully normalised coefficients.
J2 = math.sqrt(5.0) * 4.84165143790815e-4
"""Zonal coefficient of EGM2008, unnormalised and tide-free, as are J3 to J6."""
J3 = math.sqrt(7.0) * -9.57161207093473e-7
"""As J2."""
J4 = math.sqrt(9.0) * -5.39965866638991e-7
"""As J2."""
J5 = math.sqrt(11.0) * -6.86702913736681e-8
"""As J2."""
J6 = math.sqrt(13.0) * 1.49953927978527e-7
"""As J2."""
ZONALS = (J2, J3, J4, J5, J6)
"""J2 to J6."""

OMEGA_EARTH = 2.0 * math.pi * 1.00273781191135448 / 86400.0
"""Rate of the Earth rotation angle [rad/s] (IAU 2000 Resolution B1.8)."""

# World Geodetic System 1984 ellipsoid (NIMA TR8350.2, 3rd ed., Table 3.1).
WGS84_A = 6378137.0
"""Semi-major axis of the WGS84 ellipsoid [m]."""
WGS84_F = 1.0 / 298.257223563
"""Flattening of the WGS84 ellipsoid."""

# JPL DE440 (Park et al. 2021, doi:10.3847/1538-3881/abd414).
GM_SUN = 1.3271244004127942e20
"""Gravitational parameter of the Sun, of DE440 [m^3/s^2]."""
GM_MOON = 4.902800118457549e12
"""Gravitational parameter of the Moon, of DE440 [m^3/s^2]."""

AU = 149597870700.0
"""Astronomical unit [m] (IAU 2012 Resolution B2)."""
R_SUN = 6.957e8
"""Nominal radius of the Sun [m] (IAU 2015 Resolution B3)."""

# Time. MJD = JD - 2400000.5; J2000.0 is 2000-01-01T12:00:00 TT.
MJD_ZERO = 2400000.5
"""Julian Date at which the Modified Julian Date is zero [d]."""
MJD_J2000 = 51544.5
"""Modified Julian Date of J2000.0, 2000-01-01T12:00:00 TT [d]."""
SECONDS_PER_DAY = 86400.0
"""Seconds in a day without leap second."""
DAYS_PER_CENTURY = 36525.0
"""Days in a Julian century."""
TAI_MINUS_UTC = 37.0
"""TAI - UTC [s], in force since 2017-01-01 (IERS Bulletin C 52 and its successors)."""
TT_MINUS_TAI = 32.184
"""TT - TAI [s]."""
TT_MINUS_UTC = TAI_MINUS_UTC + TT_MINUS_TAI
"""TT - UTC [s] since 2017-01-01."""

OBLIQUITY_J2000 = math.radians(23.43929111)
"""Mean obliquity of the ecliptic at J2000.0 [rad], 23 deg 26' 21.448" (IAU 1976)."""

ARCSECOND = math.pi / 648000.0
"""One arcsecond [rad]."""
