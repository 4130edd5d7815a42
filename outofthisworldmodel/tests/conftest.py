"""Shared fixtures: recorded episodes of the synthetic simulator."""

import sys
from pathlib import Path

import pytest

# Tests are imported by path, not from a package, so their common helpers have to be made findable.
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).parents[1] / "tools"))

import synthetic

from owm.data.windows import Episodes, from_episodes


@pytest.fixture(scope="session")
def episodes() -> Episodes:
    """Eight minutes of all behaviours at the model's rate."""
    return from_episodes(synthetic.episodes(3, 8, 60.0))
