"""Kill recordings with frames again and again, at random moments, and compare what comes out with one left in peace.

python tools/kill_generate.py --kills 30
"""

import argparse
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CONFIG = """
fidelity = "iss"
horizon = 2.0
steps_per_action = 5
ports = ["zvezda_aft", "unity_nadir"]
observation = "state+pixels"
[camera]
width = 64
height = 64
sky = false
"""
REQUEST = ["--transitions", "300", "--val-transitions", "30", "--seed", "5", "--episodes-per-batch", "8"]


def files(root: Path) -> dict[str, bytes]:
    """Contents by path."""
    return {str(file.relative_to(root)): file.read_bytes() for file in root.rglob("*") if file.is_file()}


def main() -> None:
    """Print what was killed where, and whether the bytes agree."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, kills, runs = random.Random(options.seed), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        (root / "config.toml").write_text(CONFIG)

        def start(out: Path) -> subprocess.Popen:
            command = [sys.executable, "-m", "owm_envs", "generate", "--out", str(out), "--config"]
            return subprocess.Popen([*command, str(root / "config.toml"), *REQUEST], stderr=subprocess.DEVNULL)

        start(root / "whole").wait()  # compiled programs are on disk now, where the caller lets JAX keep them
        wanted = files(root / "whole")
        begun = time.perf_counter()
        start(root / "again").wait()
        usual = time.perf_counter() - begun
        assert files(root / "again") == wanted, "two runs differ"
        while kills < options.kills:
            out, runs = root / f"run-{runs}", runs + 1
            while not out.exists():
                # How long it takes changes with what else the machine does: what was not killed in time tells.
                begun, process, moment = time.perf_counter(), start(out), rng.uniform(0.3, 1.0) * usual
                try:
                    process.wait(moment)
                    usual = (usual + time.perf_counter() - begun) / 2
                except subprocess.TimeoutExpired:
                    process.send_signal(signal.SIGKILL)
                    process.wait()
                    kills += 1
                    pieces = len([*root.glob(f"{out.name}.partial/pieces/*/*.arrow")])
                    print(f"killed after {moment:.1f} s, {pieces} episodes safe", flush=True)
            found = files(out)
            differ = sorted(name for name in wanted.keys() | found.keys() if wanted.get(name) != found.get(name))
            print(f"run {runs}: {'differs in ' + ', '.join(differ) if differ else 'the same bytes'}", flush=True)
            if differ:
                raise SystemExit(1)
    print(f"{kills} kills, {runs} datasets, every one the same to the byte")


if __name__ == "__main__":
    main()
