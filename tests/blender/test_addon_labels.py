"""Pages and messages name panels, buttons, settings and menus as the add-on, or Blender, shows them.

In the pages on Blender a panel or a button is **bold**, a setting, a choice or a menu *italic*; emphasis has no other
use there but for captions and `LEADS`.
"""

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.blender.test_addon_fire import in_addon
from tests.test_printed_commands import texts

pytestmark = [pytest.mark.blender, pytest.mark.checkout]

ROOT = Path(__file__).parents[2]
ADDON = ROOT / "blender_addon"
TAB = "Gaussians on Fire"
PAGES = [ROOT / "docs/addon.md", *sorted((ROOT / "docs/tutorials").glob("blender_*.md"))]
BLENDERS = {"Solid", "Rendered", "Effector", "Cycles"}  # its own; all others stand in a path, A > B
NEWER = {"Splats"}  # of Blender 5.3, see test_addon_newer
UNSEEN = {"Name", "RNA", "Export Cameras", "Import Cameras"}  # of every group; titles of file dialogs
LEADS = {"Time", "You need", "Blender 4.2 and later", "Blender 3.4", "one object"}
LEADS |= {"Your own scene.", "From the side."}

REGISTERED = """
import re
from gof_blender.scene import gaussian_nodes
def names(properties):
    for kind in properties:
        if kind.type != "POINTER" and not kind.is_hidden and kind.name and kind.name != kind.identifier:
            yield kind.name
            if kind.type == "ENUM":
                yield from (item.name for item in kind.enum_items)
def settings(owner):
    yield from names(owner.bl_rna.properties)
    for kind in owner.bl_rna.properties:
        if kind.type == "POINTER" and kind.identifier != "rna_type":
            yield from settings(getattr(owner, kind.identifier))
ours = [name for name in dir(bpy.types) if name.startswith("GOF_")]
operators = [getattr(bpy.ops.gof, name).get_rna_type() for name in dir(bpy.ops.gof)]
result["panels"] = [getattr(bpy.types, name).bl_label for name in ours if "_PT_" in name]
result["buttons"] = [kind.name for kind in operators]
result["settings"] = [*settings(scene.gof), *(name for kind in operators for name in names(kind.properties))]
result["shown"] = [kind.name for part in (scene.gof.fire, scene.gof.fire.cameras, scene.gof.benchmark, scene.gof.score,
    scene.gof.reconstruction) for kind in part.bl_rna.properties if kind.name not in ("", kind.identifier)]
result["settings"] += [*names(gof_blender.ui.preferences.GOF_AddonPreferences.bl_rna.properties)]
cloud = gaussian_nodes.node_group()
result["settings"] += [item.name for item in cloud.interface.items_tree if item.item_type == "SOCKET"]
bpy.ops.gof.add_fire()
result["objects"] = [thing.name for thing in scene.objects if place.part_of(thing)]
result["operators"] = dir(bpy.ops.gof)
result["scripts"] = bpy.utils.system_resource("SCRIPTS")
result["blender"] = [name for kind in (getattr(bpy.types, name) for name in dir(bpy.types)) if hasattr(kind, "bl_rna")
                     for name in names(kind.bl_rna.properties)]
"""


def texts_drawn(path: Path) -> dict[str, set[str]]:
    """What a file writes on layouts, by the method that does: `operator`, `prop`, `label`, `menu`, ..."""
    found: dict[str, set[str]] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
            for word in (word for word in node.keywords if word.arg == "text"):
                strings = [n.value for n in ast.walk(word.value) if isinstance(n, ast.Constant)]
                found.setdefault(node.func.attr, set()).update(s for s in strings if isinstance(s, str))
    return found


def classes_named(path: Path) -> set[str]:
    """`bl_label` of a file's classes."""
    nodes = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Assign)]
    labels = [node.value for node in nodes if getattr(node.targets[0], "id", None) == "bl_label"]
    return {label.value for label in labels if isinstance(label, ast.Constant)}


@cache
def registered() -> dict[str, list[str]]:
    pytest.importorskip("bpy", reason="the add-on's labels need the bpy wheel")
    return in_addon(REGISTERED)


@cache
def pressed() -> set[str]:
    """Panels and buttons."""
    found = {*registered()["panels"], *registered()["buttons"], "Report", "Log", "Folder"}  # three of one operator
    for path in ADDON.glob("ui/*.py"):
        found |= texts_drawn(path).get("operator", set())
    return found


@cache
def chosen() -> set[str]:
    """Settings and their choices, as they are and without the unit in brackets."""
    found = set(registered()["settings"])
    return {name for name in found | {re.sub(r" \([^)]+\)$", "", name) for name in found} if name}


@cache
def blenders() -> set[str]:
    """Blender's own labels: of its properties, and what its own scripts write on layouts."""
    found = set(registered()["blender"])
    scripts = Path(registered()["scripts"])
    files = [*scripts.glob("startup/bl_*/*.py"), *(scripts / "addons_core").glob("[cb][yl]*/*.py")]
    assert len(files) > 80
    for path in files:
        found |= {text for part in texts_drawn(path).values() for text in part} | classes_named(path)
    return found | {name.removesuffix("...") for name in found}


def emphasised(text: str) -> tuple[list[str], list[str]]:
    """(bold, italic) of a page, with the first cells of tables of settings and of buttons; without captions."""
    text = re.sub(r"^```.*?^```|^\*[^*]+\*$", "", text, flags=re.MULTILINE | re.DOTALL)
    bold, italic = re.findall(r"\*\*([^*]+)\*\*", text), []
    for kind, rows in re.findall(r"^\| (setting|button) \|.*\n\|---.*\n((?:\|.*\n)+)", text, re.MULTILINE):
        cells = [name for row in rows.splitlines() for name in row.split("|")[1].split(",")]
        (italic if kind == "setting" else bold).extend(name.strip() for name in cells if "`" not in name)
    return bold, italic + re.findall(r"(?<!\*)\*([^*\n]+)\*(?!\*)", re.sub(r"\*\*[^*]+\*\*", "", text))


def wrong_labels(text: str) -> list[str]:
    """Names of a page that nothing shows so."""
    bold, italic = emphasised(text)
    wrong = [name for name in bold if name not in pressed() | LEADS]
    for name in italic:
        parts = name.split(" > ")
        known = (
            NEWER
            | chosen()
            | (blenders() | pressed() if len(parts) > 1 else BLENDERS | {TAB, *registered()["objects"]})
        )
        wrong += [name for part in parts if part not in known]
    return [*wrong, *(name for name in re.findall(r"panel \*+([^*]+)", text) if name not in registered()["panels"])]


def test_a_label_that_is_not_there_is_found():
    page = (
        "Press **Add Fire**, then **Add Smoke**. *Lift* and *Height of It*.\n\n*A caption, of one line.*\n\n"
        "| setting | meaning |\n|---|---|\n| Fuel, Oxygen | a |\n\n| button | does |\n|---|---|\n| Stop, `Esc` | b |\n"
        "\n*Edit > Preferences > No Such Menu*. The panel **Stop**.\n"
    )
    assert sorted(wrong_labels(page)) == [
        "Add Smoke",
        "Edit > Preferences > No Such Menu",
        "Height of It",
        "Oxygen",
        "Stop",
    ]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_what_a_page_on_blender_names_is_there_under_that_name(page):
    text = page.read_text(encoding="utf-8")
    assert sum(map(len, emphasised(text))) > 15
    assert wrong_labels(text) == []


def test_what_sections_on_blender_in_other_pages_name_is_there():
    pages = [page.read_text(encoding="utf-8") for page in sorted((ROOT / "docs").rglob("*.md")) if page not in PAGES]
    parts = [part for text in pages for part in re.split(r"^(?=##)", text, flags=re.MULTILINE)]
    parts = [part for part in parts if re.match(r"##.*Blender", part)]
    assert parts and [name for part in parts for name in wrong_labels(part)] == []


def test_every_lead_is_used_and_what_is_blenders_is_there():
    bold = [name for page in PAGES for name in emphasised(page.read_text(encoding="utf-8"))[0]]
    assert set(bold) >= LEADS and blenders() >= BLENDERS


def test_every_panel_button_and_setting_stands_in_the_reference():
    """Of buttons with two names, such as Add Fire and Replace Fire, both; of settings all but those of the effects."""
    text = (ROOT / "docs/addon.md").read_text(encoding="utf-8")
    labels = {re.sub(r" \([^)]+\)$", "", name) for name in pressed() | set(registered()["shown"])} - UNSEEN
    assert len(labels) > 60 and [name for name in sorted(labels) if name.removesuffix("...") not in text] == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.stem)
def test_a_button_that_any_page_tells_to_press_is_there(page):
    named = re.findall(r"[Pp]ress \*\*([^*]+)\*\*", page.read_text(encoding="utf-8"))
    assert [name for name in named if name not in pressed()] == []


NAMES = r"\b(?:[Pp]ress|[Cc]hoose|[Tt]ick|[Uu]ntick|[Ss]et|show|panel) ([A-Z][a-z-][^\n]*)"


def test_what_the_addons_messages_name_is_there_under_that_name():
    """After a verb, a word with a capital begins a label."""
    labels, wrong, seen = pressed() | chosen(), [], 0
    for path in ADDON.rglob("*.py"):
        for line, text in texts(path):
            for rest in re.findall(NAMES, text):
                seen += 1
                if not any(re.match(rf"{re.escape(label)}(?!\w)", rest) for label in labels):
                    wrong.append(f"{path.relative_to(ROOT)}:{line}: {rest[:40]}")
            panels = re.findall(r"\b[Tt]he ([A-Z]\w+) panel", text)
            wrong += [
                f"{path.relative_to(ROOT)}:{line}: panel {name}"
                for name in panels
                if name not in registered()["panels"]
            ]
    assert seen > 15
    assert not wrong, "\n".join(wrong)


def test_what_a_page_names_for_scripts_is_there():
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    operators = set(re.findall(r"bpy\.ops\.gof\.(\w+)", text))
    assert len(operators) >= 2 and operators <= set(registered()["operators"])


LABELS = {  # field of the spec: its name in an error on the Benchmark panel
    "fire.radius": "Radius",
    "fire.position": "Burner",
    "fire.start_s": "Start",
    "domain.size": "Domain",
    "domain.resolution": "Preset (cells)",
    "clip.fps": "Rate",
    "cameras.look_at": "Aim",
    "cameras.focal_mm": "Focal",
    "cameras.eval_count": "Evaluation",
    "effects.wind.strength": "Wind: Strength",
    "effects.rolling_shutter": "Rolling shutter",
    "fire.json": "fire.json",
    "render.samples": "render.samples",
}


def test_errors_name_fields_of_the_spec_by_their_labels():
    """Those without one, files of these names, and all fields of a spec file keep theirs."""
    found = in_addon(
        f"""
        from gof_blender.ui import field_labels
        fields = {[*LABELS]!r}
        result["panel"] = [field_labels.in_benchmark_panel(scene, f"lower {{name}}, or") for name in fields]
        result["fire"] = field_labels.in_fire_panel(scene, "lower domain.resolution")
        known = (*field_labels.OF_FIRE, *field_labels.OF_CAMERAS, *field_labels.OF_BENCHMARK, *field_labels.OF_PRESET)
        result["same"] = [name for name in known if field_labels.in_benchmark_panel(scene, name) == name]
        scene.gof.benchmark.background = "file"
        result["file"] = [field_labels.in_benchmark_panel(scene, f"lower {{name}}, or") for name in fields]
        """
    )
    assert found["panel"] == [f"lower {label}, or" for label in LABELS.values()]
    assert found["fire"] == "lower Cells" and found["same"] == []
    assert found["file"] == [f"lower {name}, or" for name in LABELS]
