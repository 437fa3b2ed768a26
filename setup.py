"""Package names: the folders `benchmark` and `blender_addon` install as `gof_benchmark` and `gof_blender`.

Plain `benchmark` at the top of a user's site-packages would shadow, or be shadowed by, a file of their own. `gof/core`
is installed twice: inside Blender the add-on stands alone, so it has those files under a name of its own.
"""

import os

from setuptools import find_namespace_packages, setup

FOLDERS = {"gof": "gof", "gof_benchmark": "benchmark", "gof_blender": "blender_addon"}
CORE = {"gof_blender.core": "gof/core"}

# Where the project lives: GOF_HOME_URL fills it where it is packed. `gof --help` and `gof doctor` print the last one.
HOME = os.environ.get("GOF_HOME_URL", "https://example.org/gaussians-on-fire").rstrip("/")
URLS = {"Homepage": HOME, "Documentation": f"{HOME}/docs", "Issues": f"{HOME}/issues"}

# What proves claims of the pages, and how the prior was learned: run from a checkout.
NOT_INSTALLED = ("evidence", "training")

packages = [
    name + package.removeprefix(folder)
    for name, folder in FOLDERS.items()
    for package in find_namespace_packages(include=[folder, f"{folder}.*"])
    if "__pycache__" not in package and package.split(".")[1:2] not in [[part] for part in NOT_INSTALLED]
]
setup(packages=packages, package_dir=FOLDERS | CORE, project_urls=URLS)
