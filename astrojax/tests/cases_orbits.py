"""Conformance cases of anomalies, element sets, universal variables, mean elements, special and relative orbits."""

import numpy as np

from astrojax import orbits

A = np.array
GM = A(3.986e14)
ELEMENTS = A([6.995e6, 0.05, 0.9, 1.1, 0.4, 2.0])
LONG = A([2.6e7, 0.7, 1.1, 2.1, 4.7, 0.4])
DEPUTY = ELEMENTS + A([50.0, 1e-3, 2e-3, -1e-3, 3e-3, -2e-3])
STATE = A([-3.9e6, 4.4e6, 3.4e6, -5.1e3, -5.3e3, 1.7e3])
FAST = A([-3.9e6, 4.4e6, 3.4e6, -8.1e3, -8.3e3, 2.7e3])
PARABOLA = A([1.5e7, 1.0, 0.9, 1.1, 0.4, 2.0])
ROE = A([1e-5, 2e-4, -3e-4, 1e-4, 2e-4, -1e-4])


def cases(case):
    o = orbits
    angle, hyper = (A(0.9), A(0.4)), (A(0.9), A(1.6))
    loose = {"rtol32": 2e-5, "gradient_rtol32": 2e-2}
    looser = loose | {"rtol32": 5e-5}  # by compiler
    return [
        *(
            case(name, getattr(o, name), angle, (A(-2.3), A(0.95)), rtol32=1e-5)
            for name in (
                "eccentric_to_mean",
                "eccentric_to_true",
                "mean_to_eccentric",
                "mean_to_true",
                "true_to_eccentric",
                "true_to_mean",
            )
        ),
        case("mean_to_eccentric/perigee", o.mean_to_eccentric, (A(1e-3), A(0.999)), (A(0.2), A(0.97)), **loose),
        case("hyperbolic_to_mean", o.hyperbolic_to_mean, hyper, (A(-0.3), A(1.01)), **loose),
        case("hyperbolic_to_true", o.hyperbolic_to_true, hyper),
        case("mean_to_hyperbolic", o.mean_to_hyperbolic, hyper, (A(-30.0), A(1.1)), **loose),
        case("true_to_hyperbolic", o.true_to_hyperbolic, hyper),
        case("true_to_parabolic_mean", o.true_to_parabolic_mean, (A(2.0),)),
        case("parabolic_mean_to_true", o.parabolic_mean_to_true, (A(2.0),), (A(-40.0),)),
        case("cartesian_to_equinoctial", o.cartesian_to_equinoctial, (STATE, GM), (FAST, GM), **loose),
        case("equinoctial_to_cartesian", o.equinoctial_to_cartesian, (A([7e6, 0.1, -0.2, 0.3, 0.4, 1.0]), GM)),
        case("keplerian_to_equinoctial", o.keplerian_to_equinoctial, (ELEMENTS,), (LONG,)),
        case("equinoctial_to_keplerian", o.equinoctial_to_keplerian, (A([7e6, 0.1, -0.2, 0.3, 0.4, 1.0]),), **loose),
        case("cartesian_to_conic", o.cartesian_to_conic, (FAST, GM), (STATE, GM), **loose),
        case("conic_to_cartesian", o.conic_to_cartesian, (PARABOLA, GM)),
        case(
            "propagate_universal",
            o.propagate_universal,
            (STATE, A(900.0), GM),
            (STATE, A(-7000.0), GM),
            (FAST, A(2000.0), GM),
            **loose,
        ),
        case("mean_to_osculating", o.mean_to_osculating, (ELEMENTS,), (LONG,), **loose),
        case("osculating_to_mean", o.osculating_to_mean, (ELEMENTS,), (LONG,), **loose),
        case("eccentricity_frozen", o.eccentricity_frozen, (A(7e6), A(1.7))),
        case("inclination_sun_synchronous", o.inclination_sun_synchronous, (A(7e6), A(0.01)), rtol32=1e-5),
        case("radius_geostationary", o.radius_geostationary, (GM, A(7.29e-5))),
        case("semimajor_axis_repeat", o.semimajor_axis_repeat, (A(43.0), A(3.0), A(0.01), A(1.7)), rtol32=1e-5),
        case("keplerian_to_roe", o.keplerian_to_roe, (ELEMENTS, DEPUTY), rtol32=1e-3, gradient_rtol32=1e-2),
        case("roe_to_keplerian", o.roe_to_keplerian, (ELEMENTS, ROE), gradient_rtol32=1e-2),
        case("stm_roe_j2", o.stm_roe_j2, (ELEMENTS, A(6000.0), GM), rtol32=1e-5),
        case("stm_yamanaka_ankersen", o.stm_yamanaka_ankersen, (LONG, A(6000.0), GM), (LONG, A(-90.0), GM), **looser),
    ]


REPORT = "the report's C++ code and verification file"
DRIFT = "brahe; derivative of the secular drift"
MODELS = [
    ("orbits", "SGP4 and SDP4", "AIAA 2006-6753", REPORT, "0.12 mm, 0.24 um/s", "the whole file"),
    ("orbits", "Kepler's equation", "Danby; Battin", "its residual; brahe", "4e-15", "e to 0.9999, from 1.0001"),
    ("orbits", "universal variables", "Battin; Conway", "SciPy DOP853; round trips", "1e-9 relative", "e from 0 to 10"),
    ("orbits", "mean elements", "Brouwer; Lyddane", "SciPy DOP853 under J2", "11 m, 1e-6 rad", "e to 0.15"),
    ("orbits", "Yamanaka-Ankersen", "their paper", "derivative of two-body motion", "1e-10 relative", "e to 0.8"),
    ("orbits", "relative elements", "D'Amico; Koenig et al.", DRIFT, "1e-9 relative", "e to 0.7"),
    ("attitude", "Euler, MRP, axis-angle", "Schaub & Junkins", "SciPy", "1e-13 rad", "all"),
]
