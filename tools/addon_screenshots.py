"""Open the add-on in a real window, press its buttons, and photograph the panels for docs/addon.md.

    python tools/addon_screenshots.py --result RESULT.npz --dataset DATASET [--out docs/images]
                                      [--work out/addon_window]

Needs Debian's packages blender, python3-numpy, python3-openimageio, python3-openvdb, xvfb, xdotool and imagemagick.
The window is drawn by software on a virtual screen. Builds the zip, installs it into an empty user folder and starts
that Blender; then plays a person: moves the pointer and presses. Every press is checked by what it has done to the
scene; a press without effect ends the script with an error and a picture of the screen.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))
import build_addon

SCREEN = (1600, 1100)
DISPLAY = ":77"
NEEDED = ("blender", "Xvfb", "xdotool", "import", "convert")
# Where things are on this screen, with the theme and the sizes of factory settings.
TAB = (1307, 276)
ADD_FIRE, ADD_CAMERAS, NEXT_VIEW, BENCHMARK_BELOW = (1205, 419), (1205, 802), (1205, 822), (1152, 883)
BAKE_AND_RENDER, PANEL_END = (1205, 389), 640  # the button stands as far down as the plan is long
THINGS = "len(bpy.context.scene.objects)"
DESELECT = "bpy.ops.object.select_all(action='DESELECT')"  # the active object stays that of the panel
SIDEBAR = "222x548+1098+60"
QUESTION = "400x180+310+690"
IMPORT = (1205, 183)  # in the third panel, when the first two are closed
EXPORT_VDB, EXPORT_POINTS = (1204, 605), (1204, 626)  # likewise, with a reconstruction, in Solid view
DIALOG_FOLDER, DIALOG_FIRST_FILE, DIALOG_IMPORT = (720, 48), (500, 105), (1527, 1057)
FIRST_HEADER, HEADER_STEP = (1152, 97), 28  # of the panels when all are closed

INSTALL = """
import bpy, sys
bpy.ops.preferences.addon_install(filepath=sys.argv[-1], overwrite=True)
bpy.ops.preferences.addon_enable(module="gaussians_on_fire")
assert hasattr(bpy.types.Scene, "gof"), "the add-on does not start"
bpy.context.preferences.view.show_splash = False
bpy.ops.wm.save_userpref()
"""

OBEY = """
import bpy, json, os, sys, traceback
folder = sys.argv[-1]
def obey():
    order, answer = (os.path.join(folder, name) for name in ("order", "answer"))
    if os.path.exists(order):
        code = open(order).read()
        os.remove(order)
        window = bpy.context.window_manager.windows[0]
        area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
        region = next(region for region in area.regions if region.type == "WINDOW")
        names = {"bpy": bpy, "area": area, "scene": window.scene, "view": area.spaces.active, "gof": window.scene.gof}
        try:
            with bpy.context.temp_override(window=window, area=area, region=region):
                *body, last = code.strip().split("\\n")
                exec("\\n".join(body), names)
                said = {"value": eval(last, names)}
            area.tag_redraw()
        except Exception:
            said = {"error": traceback.format_exc()}
        with open(answer + ".tmp", "w") as file:
            json.dump(said, file)
        os.replace(answer + ".tmp", answer)
    return 0.1
bpy.app.timers.register(obey, persistent=True)
"""


class BlenderWindow:
    """A Blender on a virtual screen."""

    def __init__(self, work: Path, zip_path: Path):
        self.work = work
        environment = {key: value for key, value in os.environ.items() if not key.startswith("BLENDER_")}
        # Debian's Blender takes the libraries of the python3 that it finds first, which must be Debian's.
        self._environment = environment | {
            "BLENDER_USER_RESOURCES": str(work / "user"),
            "XDG_CACHE_HOME": str(work / "cache"),  # a machine that has made no benchmark yet
            "DISPLAY": DISPLAY,
            "LIBGL_ALWAYS_SOFTWARE": "1",
            "PATH": os.defpath,
        }
        scripts = {name: work / f"{name}.py" for name in ("install", "obey")}
        for path, text in zip(scripts.values(), (INSTALL, OBEY), strict=True):
            path.write_text(text)
        subprocess.run(
            [
                "blender",
                "-b",
                "--factory-startup",
                "--python-exit-code",
                "1",
                "--python",
                scripts["install"],
                "--",
                zip_path,
            ],
            env=self._environment,
            check=True,
            stdout=subprocess.DEVNULL,
            timeout=120,
        )
        self._screen = subprocess.Popen(
            ["Xvfb", DISPLAY, "-screen", "0", f"{SCREEN[0]}x{SCREEN[1]}x24", "+extension", "GLX"],
            stderr=subprocess.DEVNULL,
        )
        time.sleep(1)
        place = ["-p", "0", "0", *map(str, SCREEN)]
        with open(work / "blender.log", "w") as log:
            self._blender = subprocess.Popen(
                ["blender", "--no-window-focus", *place, "--python", scripts["obey"], "--", work],
                env=self._environment,
                stdout=log,
                stderr=log,
            )

    def __enter__(self) -> BlenderWindow:
        return self

    def __exit__(self, kind, *_) -> None:
        if kind and self._screen.poll() is None:
            self.photograph(self.work / "failed.png")
        for process in (self._blender, self._screen):
            process.terminate()
            process.wait()

    def python(self, code: str, seconds: float = 120):
        """Run lines in the window's Blender; the value of the last."""
        answer = self.work / "answer"
        answer.unlink(missing_ok=True)
        (self.work / "order.tmp").write_text(code)
        (self.work / "order.tmp").replace(self.work / "order")
        self.wait(answer.exists, seconds)
        said = json.loads(answer.read_text())
        if "error" in said:
            raise SystemExit(f"Blender: {said['error']}")
        return said["value"]

    def wait(self, condition, seconds: float = 60) -> None:
        end = time.monotonic() + seconds
        while not condition():
            if self._blender.poll() is not None or time.monotonic() > end:
                raise TimeoutError(
                    f"Blender has ended ({self._blender.poll()}) or does not do what it should; see {self.work}"
                )
            time.sleep(0.1)

    def press(self, x: int, y: int, check: str = "True", key: str | None = None) -> None:
        """Press the left button at a place, with a key held, and wait until Python's `check` holds in Blender."""
        self._pointer("mousemove", x, y)
        self._pointer("mousemove_relative", 1, 1)  # a button must have seen the pointer before it can be pressed
        if key:
            self._pointer("keydown", key)
        self._pointer("mousedown", 1)
        self._pointer("mouseup", 1)
        if key:
            self._pointer("keyup", key)
        time.sleep(1)
        self.wait(lambda: self.python(check))
        self._pointer("mousemove", 500, 700)

    def press_below(self, x: int, y: int, end: int, check: str) -> None:
        """Press at a place and further down, over lines of text, until Python's `check` holds."""
        for place in range(y, end, 12):  # a button is 20 px high
            self.press(x, place)
            if self.python(check):
                return
        raise TimeoutError(f"no button between {y} and {end} does what it should; see {self.work}")

    def key(self, name: str) -> None:
        self._pointer("key", name)

    def settle(self) -> None:
        """Give the sidebar the time and the pointer's motion that its animations need, drawn by software."""
        for _ in range(2):
            for y in (400, 420, 440):
                self._pointer("mousemove", 1190, y)
                time.sleep(1)
            self._pointer("mousemove", 500, 700)
            self.python("area.tag_redraw()")

    def click(self, x: int, y: int, times: int = 1) -> None:
        """Press where no 3D view is, which `press` would ask."""
        self._pointer("mousemove", x, y)
        self._pointer("mousemove_relative", 1, 1)
        self._pointer("click", "--repeat", times, "--delay", 80, 1)
        time.sleep(2)

    def type(self, text: str) -> None:
        self._pointer("type", "--delay", 30, text)

    def undone(self, number: str) -> None:
        """Undo and redo with the keys: Python's `number` changes, and is as before again."""
        before = self.python(number)
        self.key("ctrl+z")
        self.wait(lambda: self.python(number) != before)
        self.key("ctrl+shift+z")
        self.wait(lambda: self.python(number) == before)

    def rest(self) -> None:
        """Wait until a view that is slow to draw has been drawn."""
        for _ in range(3):
            time.sleep(2)
            self.python("area.tag_redraw()")

    def photograph(self, path: Path, crop: str | None = None, width: int | None = None) -> None:
        """Save the screen; `crop` and `width` are ImageMagick's geometries."""
        time.sleep(1.5)
        subprocess.run(["import", "-window", "root", path.with_suffix(".png")], env=self._environment, check=True)
        if path.suffix != ".png" or crop or width:
            options = (["-crop", crop, "+repage"] if crop else []) + (["-resize", f"{width}x"] if width else [])
            subprocess.run(["convert", path.with_suffix(".png"), *options, "-quality", "82", path], check=True)
            if path.suffix != ".png":
                path.with_suffix(".png").unlink()

    def _pointer(self, *words) -> None:
        subprocess.run(["xdotool", *map(str, words)], env=self._environment, check=True, capture_output=True)
        time.sleep(0.5)


def panel(number: int) -> tuple[int, int]:
    """Return the header of a panel, counted from 0, when those before it are closed."""
    return FIRST_HEADER[0], FIRST_HEADER[1] + number * HEADER_STEP


def fire(window: BlenderWindow, out: Path) -> None:
    """Show a fire on the default cube, seen through the rig's second camera."""
    window.key("n")
    window.wait(lambda: window.python("view.show_region_ui"))
    window.settle()
    window.press(*TAB)
    window.python("gof.fire.spot = 'OBJECT'\nNone")
    window.press(*ADD_FIRE, "any(thing.get('gof_part') == 'domain' for thing in scene.objects)")
    window.settle()  # the fire is drawn for the first time
    window.undone(THINGS)
    window.press(*ADD_CAMERAS, "sum(thing.type == 'CAMERA' for thing in scene.objects) == 4")
    window.undone(THINGS)
    window.press(*NEXT_VIEW, "view.region_3d.view_perspective == 'CAMERA'")
    window.press(*NEXT_VIEW, "scene.camera.name == 'cam_1'")
    window.python("for frame in range(1, 41): scene.frame_set(frame)\nNone", 300)
    window.rest()
    window.settle()
    window.photograph(out / "addon_fire.webp", crop="1600x1000+0+0", width=1000)


def benchmark(window: BlenderWindow, out: Path) -> None:
    """Show a dataset of that scene: begun, stopped with Esc in the bake and in the pictures, gone on with, finished."""
    window.press(*BENCHMARK_BELOW, key="ctrl")  # opens it and closes the others
    folder = window.work / "cube_fire"
    window.python(f"gof.benchmark.folder = {str(folder)!r}\nNone")
    window.settle()
    window.photograph(out / "addon_plan.webp", crop=SIDEBAR)
    running = "bpy.types.GOF_OT_bake_render.job is not None"
    job = "bpy.types.GOF_OT_bake_render.job"
    window.press_below(*BAKE_AND_RENDER, PANEL_END, running)
    window.wait(lambda: window.python(f"{job}.stage == 'bake' and {job}.share > 0"), 300)
    window.key("Escape")
    time.sleep(10)  # a busy machine draws late
    window.photograph(out / "addon_stop.webp", crop=QUESTION)
    window.key("Return")
    window.wait(lambda: not window.python(running), 300)
    assert (folder / ".cache" / "bake-finished.json").is_file(), "a bake is finished before the benchmark stops"
    assert not list(folder.glob("cameras/*/exr/0*.exr"))
    window.settle()
    window.press_below(*BAKE_AND_RENDER, PANEL_END, running)  # now "Resume"
    window.wait(lambda: window.python(f"{job}.stage == 'render'"), 300)
    window.wait(lambda: len(list(folder.glob("cameras/*/exr/0*.exr"))) > 5, 300)
    window.settle()
    window.photograph(out / "addon_benchmark.webp", crop=SIDEBAR)
    playing = "bpy.context.window_manager.windows[0].screen.is_animation_playing"
    window.key("space")
    window.wait(lambda: window.python(playing))
    window.key("Escape")
    window.wait(lambda: not window.python(playing))
    assert window.python(running), "while an animation is played, Esc ends that alone"
    window.key("Escape")
    time.sleep(2)
    assert window.python(running), "Esc asks before it ends a benchmark"
    window.photograph(window.work / "question.png")
    window.key("Return")
    window.wait(lambda: not window.python(running))
    kept = len(list(folder.glob("cameras/*/exr/0*.exr")))
    window.settle()
    window.press_below(*BAKE_AND_RENDER, PANEL_END, running)  # now "Resume"
    window.wait(lambda: (folder / "report.html").is_file(), 600)
    window.wait(lambda: not window.python(running))
    print(f"benchmark: stopped after {kept} pictures, finished; {(folder / '.cache' / 'job.log').read_text()}")
    window.settle()
    window.press(*panel(1))


def reconstruction(window: BlenderWindow, out: Path, result: Path, dataset: Path) -> None:
    """Show a reconstruction in an empty scene, chosen in the file dialog, and its score."""
    chosen = window.work / "chosen" / result.name
    chosen.parent.mkdir()
    shutil.copy(result, chosen)
    window.python("bpy.context.preferences.view.filebrowser_display_type = 'SCREEN'\nNone")
    window.python("bpy.ops.object.select_all(action='SELECT'); bpy.ops.object.delete(); scene.frame_set(6)\nNone")
    window.settle()
    window.press(*panel(2))  # while the view is quickly drawn
    window.settle()
    window.click(*IMPORT)
    window.click(*DIALOG_FOLDER, times=2)
    window.key("ctrl+a")
    window.type(f"{chosen.parent}/")
    window.key("Return")
    time.sleep(3)
    window.click(*DIALOG_FIRST_FILE)
    window.click(*DIALOG_IMPORT)
    window.wait(lambda: window.python(f"{THINGS} == 1"), 300)
    window.undone(THINGS)
    window.settle()
    exports(window)
    window.python("bpy.ops.view3d.view_axis(type='FRONT'); view.shading.type = 'MATERIAL'\nNone")
    select = "thing = scene.objects[0]; bpy.context.view_layer.objects.active = thing; thing.select_set(True)"
    window.python(f"{select}\nscene.frame_set((scene.frame_start + scene.frame_end) // 2)\nNone")
    window.python(f"bpy.ops.view3d.view_selected(); {DESELECT}\nNone")
    window.rest()
    window.settle()
    window.photograph(out / "addon_reconstruction.webp", crop="1600x1000+0+0", width=1000)
    for number in (2, 3):
        window.press(*panel(number))
        window.settle()
    window.python(f"gof.score.dataset = {str(dataset)!r}\nNone")
    window.python("bpy.ops.gof.score()\nNone", 600)
    window.python("bpy.ops.gof.show_errors()\nNone", 300)
    window.python(f"bpy.ops.view3d.view_all(); {DESELECT}\nNone")
    window.settle()
    window.rest()
    window.photograph(out / "addon_score.webp", crop="1600x1000+0+0", width=1000)


def exports(window: BlenderWindow) -> None:
    """OpenVDB files by the file dialog; and why Debian's Blender writes no points, said before the dialog."""
    folder = window.work / "exported"
    folder.mkdir()
    last = window.python("end, scene.frame_end = scene.frame_end, scene.frame_start + 2\nend")
    window.click(*EXPORT_VDB)
    window.click(*DIALOG_FOLDER, times=2)
    window.key("ctrl+a")
    window.type(f"{folder}/")
    window.key("Return")
    time.sleep(3)
    window.photograph(window.work / "export_dialog.png")
    window.click(*DIALOG_IMPORT)
    window.wait(lambda: len(list(folder.glob("*.vdb"))) == 3, 120)
    window.settle()
    before = window.python("len(bpy.context.window_manager.windows[0].screen.areas)")
    window.click(*EXPORT_POINTS)
    window.photograph(window.work / "no_points.png")
    assert window.python("len(bpy.context.window_manager.windows[0].screen.areas)") == before, "no dialog has opened"
    window.python(f"scene.frame_end = {last}\nNone")
    for path in sorted(folder.glob("*.vdb")):
        print(f"exported: {path.name}, {path.stat().st_size / 1e6:.1f} MB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--result", type=Path, required=True, help="a reconstruction, for the last two panels")
    parser.add_argument("--dataset", type=Path, required=True, help="the dataset it was made from")
    parser.add_argument("--out", type=Path, default=build_addon.ROOT / "docs" / "images", help="folder of the pictures")
    parser.add_argument(
        "--work",
        type=Path,
        default=build_addon.ROOT / "out" / "addon_window",
        help="folder for everything else; emptied",
    )
    args = parser.parse_args()
    missing = [name for name in NEEDED if not shutil.which(name)]
    if missing:
        raise SystemExit(f"not found: {', '.join(missing)}; apt-get install blender xvfb xdotool imagemagick")
    work, out = args.work.resolve(), args.out.resolve()
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    out.mkdir(parents=True, exist_ok=True)
    with BlenderWindow(work, build_addon.build(work)) as window:
        time.sleep(5)
        fire(window, out)
        benchmark(window, out)
        reconstruction(window, out, args.result.resolve(), args.dataset.resolve())
    return 0


if __name__ == "__main__":
    sys.exit(main())
