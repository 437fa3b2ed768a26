"""Write requirements.lock: the exact packages of `make setup`, each with the hash of its file.

    python tools/lock.py           with the Python that make takes (3.11), on Linux x86-64

PyTorch is not in it: which build is right differs from machine to machine (the Makefile's TORCH).
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LOCK = ROOT / "requirements.lock"
EXTRAS = "blender,torch,dev,fast"  # as the Makefile installs
BUILDERS = ("pip", "setuptools")  # they install the others and `gof` itself
LEFT_OUT = ("gaussians-on-fire", "torch")
HEAD = """\
# Written by tools/lock.py: what `make setup` installs on Linux x86-64 with Python 3.11, without PyTorch.
# To take newer versions: python tools/lock.py, make test, commit.
"""


def resolved() -> list[dict]:
    """Return the packages that pip would install into an empty environment, by its report."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
        subprocess.run([*command, "--report", str(report), f"{ROOT}[{EXTRAS}]", *BUILDERS], check=True)
        return json.loads(report.read_text(encoding="utf-8"))["install"]


def lines(installed: list[dict]) -> list[str]:
    found = []
    for one in installed:
        name, version = one["metadata"]["name"].lower().replace("_", "-"), one["metadata"]["version"]
        if name not in LEFT_OUT and not name.startswith(("nvidia-", "cuda-", "triton")):
            found.append(f"{name}=={version} --hash=sha256:{one['download_info']['archive_info']['hashes']['sha256']}")
    return sorted(found)


def main() -> int:
    found = lines(resolved())
    LOCK.write_text(HEAD + "\n".join(found) + "\n", encoding="utf-8")
    print(f"{LOCK.name}: {len(found)} packages")
    return 0


if __name__ == "__main__":
    sys.exit(main())
