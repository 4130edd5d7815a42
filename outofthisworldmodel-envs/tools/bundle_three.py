"""Bundle what the replay's page needs of three.js into one file: `python tools/bundle_three.py`; needs node and npm.

Only what `replay/assets/*.js` names is exported, so that the bundler leaves the rest out.
"""

import hashlib
import json
import re
import subprocess
import tempfile
from pathlib import Path

THREE, ESBUILD = "0.187.0", "0.28.2"
ASSETS = Path(__file__).parents[1] / "src" / "owm_envs" / "replay" / "assets"


def main() -> None:
    """Write `three.min.js` beside the scripts, its licence at its head, and print what ASSETS.md tells of it."""
    scripts = [file for file in sorted(ASSETS.glob("*.js")) if file.name != "three.min.js"]
    names = {name for file in scripts for name in re.findall(r"\bTHREE\.(\w+)", file.read_text(encoding="utf-8"))}
    names = sorted(names - {"OrbitControls"})
    with tempfile.TemporaryDirectory() as folder:
        package = {"private": True, "dependencies": {"three": THREE, "esbuild": ESBUILD}}
        Path(folder, "package.json").write_text(json.dumps(package), encoding="utf-8")
        subprocess.run(["npm", "install", "--silent", "--no-audit", "--no-fund"], cwd=folder, check=True)
        controls = 'export { OrbitControls } from "three/addons/controls/OrbitControls.js";'
        entry = f'export {{ {", ".join(names)} }} from "three";\n{controls}\n'
        Path(folder, "entry.js").write_text(entry, encoding="utf-8")
        bundle = ["npx", "esbuild", "entry.js", "--bundle", "--minify", "--format=iife", "--global-name=THREE"]
        made = subprocess.run(
            [*bundle, "--legal-comments=none", "--charset=ascii"], cwd=folder, check=True, capture_output=True
        )
        licence = Path(folder, "node_modules", "three", "LICENSE").read_text(encoding="utf-8").strip()
    head = f"/* three.js {THREE}, parts of it, bundled by esbuild {ESBUILD}\n\n{licence}\n*/\n"
    data = head.encode() + made.stdout
    (ASSETS / "three.min.js").write_bytes(data)
    print(f"three.min.js: {len(data):,} bytes, sha256 {hashlib.sha256(data).hexdigest()}")


if __name__ == "__main__":
    main()
