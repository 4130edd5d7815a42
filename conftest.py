"""What the tests of all three packages share: JAX's strictness flags, to be set as a caller would."""

import contextlib
import gc

import jax
import pytest

# Tracing makes objects by the million, few of them in circles: by default the collector takes a tenth of the time.
gc.set_threshold(100_000, 50, 50)

STRICT = {
    "numpy_dtype_promotion": "strict",
    "numpy_rank_promotion": "raise",
    "legacy_prng_key": "error",
    "check_static_indices": True,
}
"""Of these each raises an error of its own while a program is traced, so they can be tried together."""


@pytest.fixture(scope="session")
def jax_flags():
    """A context manager that sets flags of JAX's for every thread; `strict` stands for all of `STRICT`."""

    @contextlib.contextmanager
    def flags(*, strict: bool = False, **values):
        values = {**(STRICT if strict else {}), **values}
        before = {name: jax.config.values[f"jax_{name}"] for name in values}
        try:
            for name, value in values.items():
                jax.config.update(f"jax_{name}", value)
            yield
        finally:
            for name, value in before.items():
                jax.config.update(f"jax_{name}", value)

    return flags
