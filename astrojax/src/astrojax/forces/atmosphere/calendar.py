"""The day of the year, as an atmosphere asks for it."""

import jax.numpy as jnp
from jaxtyping import Array, Int

from astrojax._types import Scalar


def year_and_day(day: Scalar) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Calendar year, and day of the year from 1, of a whole Modified Julian Day.

    Validity: the Gregorian calendar, any year.

    Source: Fliegel and Van Flandern (1968), Communications of the ACM 11(10), 657, with years that begin in March.
    """
    days = jnp.floor(jnp.asarray(day)).astype(jnp.int32) + 678881  # since 0000-03-01
    era, of_era = days // 146097, days % 146097
    year_of_era = (of_era - of_era // 1460 + of_era // 36524 - of_era // 146096) // 365
    of_march_year = of_era - (365 * year_of_era + year_of_era // 4 - year_of_era // 100)
    late = of_march_year >= 306  # January and February belong to the next year
    year = era * 400 + year_of_era + jnp.where(late, 1, 0)
    leap = ((year % 4 == 0) & (year % 100 != 0)) | (year % 400 == 0)
    return year, jnp.where(late, of_march_year - 305, of_march_year + 60 + jnp.where(leap, 1, 0))
