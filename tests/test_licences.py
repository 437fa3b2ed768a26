"""The licences of what an installation brings: copyleft comes with the extra `blender` only, or is stated."""

import importlib.metadata
import importlib.util
from pathlib import Path

import pytest

from tools import licences

ROOT = Path(__file__).parents[1]
pytestmark = pytest.mark.checkout


def fake(folder, name, *lines):
    """An installed package that has these lines of metadata."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    text = "\n".join(["Metadata-Version: 2.4", f"Name: {name}", "Version: 1.0", *lines])
    (info / "METADATA").write_text(text + "\n")
    return importlib.metadata.Distribution.at(info)


@pytest.mark.parametrize("extra", ["", *[extra for extra in licences.extras() if extra != "blender"]])
def test_no_extra_but_blender_brings_copyleft(extra):
    packages = licences.brought_by(licences.NAME, [extra])
    assert {"numpy", "scipy", "drjit"} <= set(packages)
    assert not licences.objections(packages)


def test_an_installation_without_extras_is_whole_here():
    assert None not in licences.brought_by(licences.NAME).values()


def test_blender_is_copyleft_and_that_is_seen():
    """The same question answered otherwise: the check can fail."""
    pytest.importorskip("bpy", reason="the extra 'blender' is not installed")
    assert licences.objections(licences.brought_by(licences.NAME, ["blender"])) == ["bpy: GPL-3.0"]


@pytest.mark.parametrize(
    "line",
    [
        "License: GNU GENERAL PUBLIC LICENSE",  # as plyfile says it
        "License: GPLv3",
        "License-Expression: GPL-3.0-or-later",
        "License-Expression: MIT AND LGPL-2.1-only",
        "Classifier: License :: OSI Approved :: GNU Lesser General Public License v3 (LGPLv3)",
        "License-Expression: MPL-2.0",
        "License: CC BY-NC 4.0",
        "License: ask the author",
        "Summary: says nothing",
    ],
)
def test_copyleft_and_unknown_licences_are_refused(tmp_path, line):
    (wrong,) = licences.objections({"thing": fake(tmp_path, "thing", line)})
    assert wrong.startswith("thing: ")


@pytest.mark.parametrize(
    "line",
    [
        "License: BSD",
        "License-Expression: MIT",
        "License: Apache 2.0\n        GPL not",
        "License: LicenseRef-TOST-1.0",  # as usd-core says it
    ],
)
def test_free_licences_are_not(tmp_path, line):
    assert not licences.objections({"thing": fake(tmp_path, "thing", line)})


def test_an_exception_holds_for_the_licence_that_it_states_only(tmp_path):
    assert not licences.objections(
        {"hypothesis": fake(tmp_path / "a", "hypothesis", "License-Expression: MPL-2.0 AND MIT")}
    )
    assert licences.objections({"hypothesis": fake(tmp_path / "b", "hypothesis", "License-Expression: AGPL-3.0-only")})


@pytest.mark.parametrize("name", licences.EXCEPTIONS)
def test_every_exception_is_still_needed(name):
    """One whose package has gone, or has another licence now, would hide the next."""
    if name in ("certifi", "pathspec") and importlib.util.find_spec("mkdocs") is None:
        pytest.skip(f"{name} comes with the extra site, which the two commands do not install")
    said = licences.licence(importlib.metadata.distribution(name))
    assert licences.COPYLEFT.search(said), said
    assert any(name in licences.brought_by(licences.NAME, [extra]) for extra in licences.extras() if extra != "blender")


@pytest.mark.parametrize("name", licences.INSIDE)
def test_what_is_said_to_be_inside_a_wheel_is_there(name):
    """The binaries were looked into once; this looks again, so that the page stays true."""
    files = importlib.metadata.distribution(name).files
    binaries = [f.locate() for f in files if ".so" in f.name]
    assert any(licences.INSIDE[name][2] in path.read_bytes() for path in binaries)


def test_requirements_of_requirements_and_their_extras_are_walked(tmp_path, monkeypatch):
    fake(tmp_path, "top", "Requires-Dist: middle[more]", "Provides-Extra: side", "Requires-Dist: far; extra == 'side'")
    fake(tmp_path, "middle", "Provides-Extra: more", "Requires-Dist: deep; extra == 'more'", "Requires-Dist: top")
    fake(tmp_path, "deep", "License: GPL", "Requires-Dist: never; python_version < '3'")
    monkeypatch.syspath_prepend(tmp_path)
    found = licences.brought_by("top")
    assert set(found) == {"middle", "deep"} and licences.objections(found)[0] == "deep: GPL"
    assert licences.brought_by("top", ["side"])["far"] is None


def test_the_page_has_the_exceptions():
    page = (ROOT / "docs/install.md").read_text()
    assert all(name in page for name in [*licences.EXCEPTIONS, *licences.INSIDE]) and "GPL" in page
