"""Astrodynamics as pure, differentiable JAX functions (SI units, radians, scalar-first quaternions)."""

from importlib import metadata as _metadata

__version__ = "0.1.0"


def _refuse_foreign_distribution() -> None:
    """Stop when the unrelated PyPI project `astrojax` shares this import name."""
    try:
        foreign = _metadata.distribution("astrojax")
    except _metadata.PackageNotFoundError:
        return
    raise ImportError(
        f"the distribution 'astrojax' {foreign.version} is installed beside 'outofthisworldmodel-astrojax'; "
        "both provide the import package 'astrojax', so their files overwrite each other. "
        "Fix: pip uninstall astrojax, then install ours again from its source, as the README says"
    )


_refuse_foreign_distribution()

from astrojax import (  # noqa: E402  (the check above must come first)
    attitude,
    constants,
    ephemeris,
    estimate,
    forces,
    frames,
    orbits,
    propagate,
    time,
)

__all__ = [
    "attitude",
    "constants",
    "ephemeris",
    "estimate",
    "forces",
    "frames",
    "orbits",
    "propagate",
    "time",
]
