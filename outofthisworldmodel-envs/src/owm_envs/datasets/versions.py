"""What recorded a dataset: versions of the programs, and the revision of their source."""

import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = {
    "owm_envs": "outofthisworldmodel-envs",
    "astrojax": "outofthisworldmodel-astrojax",
    **{name: name for name in ("jax", "jaxlib", "numpy", "pyarrow", "av")},
}


def versions() -> dict[str, str]:
    """Versions by name; of a source checkout its git revision too, with "+" if files of it were changed."""
    found = {"python": platform.python_version(), "machine": platform.machine()}
    for name, distribution in _PACKAGES.items():
        try:
            found[name] = version(distribution)
        except PackageNotFoundError:
            continue
    if revision := _revision():
        found["revision"] = revision
    return found


def _revision() -> str:
    here = Path(__file__).resolve().parent
    if not any((folder / ".git").exists() for folder in here.parents):
        return ""
    command = ["git", "-C", str(here), "describe", "--always", "--abbrev=40", "--exclude=*", "--dirty=+"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=20, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""
