"""A dataset in the making: the generator's stages one after another, each in a Blender process of its own.

Nothing here waits: ``poll`` takes what the child has said since the last call, so that a user interface can go on.
Finished work of a stopped job stays, and the next job for the same folder goes on there.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import time
from html import escape
from pathlib import Path

from ..core.checked_json import SpecError
from ..core.costs import StageCost, StageLog
from ..core.description import CameraEntry, DatasetDescription
from ..core.files import read_json, write_text
from ..core.time_left import TimeLeft, duration
from . import cost_model, effects
from . import spec as scene_spec
from .brightness import Brightness
from .child import JobError, WorkerMessages, code, last_lines
from .layout import Layout
from .spec import SceneSpec

UNITS = {"bake": " steps", "render": " pictures", "ground-truth": " frames"}


def stages(spec: SceneSpec) -> list[str]:
    """Return the stages that a spec needs, in order."""
    video = ["video"] if any(map(effects.encodes, spec.effects)) else []
    flow = ["flow"] if "flow" in spec.ground_truth else []
    return ["bake", "render", *video, "ground-truth", *flow, "finish"]


def expected_s(spec: SceneSpec, prediction: cost_model.Prediction) -> dict[str, float]:
    """Return seconds on the clock that each stage should take when nothing else runs.

    The prediction is in CPU seconds over cores; bake and export keep one core busy, not all.
    """
    known = {
        "bake": prediction.bake_s * cost_model.CORES,
        "render": prediction.render_s,
        "ground-truth": prediction.ground_truth_s * cost_model.CORES,
    }
    return {stage: known.get(stage, 2.0) for stage in stages(spec)}


def left_s(spec: SceneSpec, layout: Layout, expected: dict[str, float]) -> dict[str, float]:
    """Return those of the expected seconds that a dataset still needs that was begun in the folder."""
    if not layout.bake_marker.is_file():
        return expected | {"bake": expected["bake"] * max(1 - layout.newest_step() / spec.timeline.last_frame, 0.0)}
    missing = max(1 - layout.pictures() / len(spec.pictures), 0.0)
    return expected | {"bake": 0.0, "render": expected["render"] * missing}


class Job:
    """The work on one dataset folder that ``Layout.claim`` has given to a spec.

    Attributes:
        stage: the stage that runs, "" before the first and after the last.
        fraction: expected share of the work that is done, 0..1.
        seconds_left: by the rule of `core.time_left`.
    """

    def __init__(self, spec: SceneSpec, layout: Layout, python: list[str]):
        """``python``: a command that runs the Python code given as its next argument, in a Blender without a window."""
        self.spec, self.layout = spec, layout
        self.stage = ""
        self._python = python
        self._expected = expected_s(spec, cost_model.predict_here(spec))
        self._pace = TimeLeft(self._expected)
        self._heard = 0.0
        self._waiting = stages(spec)
        self._process: subprocess.Popen | None = None
        self._messages = WorkerMessages()
        self._start = 0.0
        self._log = StageLog(layout.costs)

    @property
    def fraction(self) -> float:
        total = sum(self._expected.values())
        now = self._expected[self.stage] * (1 - self._messages.share) if self.stage else 0.0
        return max(1.0 - (now + self._later()) / total, 0.0)  # sums in another order differ by a rounding

    @property
    def seconds_left(self) -> float:
        return self._left_here() + self._pace.slowness * self._later()

    def __str__(self) -> str:
        left = duration(self.seconds_left)
        if not self._messages.total:
            return f"{self.stage or 'ready'} starts, about {left} left"
        return f"{self.stage} {self._messages.done} of {self._messages.total}{UNITS.get(self.stage, '')}, {left} left"

    def poll(self) -> bool:
        """Take note of progress and go on to the next stage. Returns whether there is more to do.

        Raises:
            JobError: a stage failed; its last lines are in the message and in the log.
        """
        self._messages.read()
        if self._process is not None:
            status = self._process.poll()
            if status is None:
                return True
            self._end_of_stage(status)
        while self._waiting:
            self.stage = self._waiting.pop(0)
            if not self._is_finished():
                self._begin()
                return True
        self.stage = ""
        write_page(self.layout)
        self._note(f"finished: {self.layout.description}")
        return False

    def run(self, every_s: float = 0.2) -> None:
        """Do all of it now. Raises JobError; on any exception the child is stopped."""
        try:
            while self.poll():
                time.sleep(every_s)
        finally:
            self.stop()

    def stop(self) -> None:
        """End the child, if one runs; what it has finished stays."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
            self._note(f"stopped in {self.stage}")

    def _is_finished(self) -> bool:
        done = {"bake": self.layout.bake_marker, "finish": self.layout.description}.get(self.stage)
        return done is not None and done.is_file()

    def _begin(self) -> None:
        arguments = ["--spec", str(self.layout.local_spec), "--out", str(self.layout.root), "--stage", self.stage]
        self._start = time.monotonic()
        self._note(f"{self.stage} ...")
        with open(self._errors(), "ab") as errors:
            # The child ends with its standard input, hence with this process.
            self._process = subprocess.Popen(
                [*self._python, code("generate", arguments)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
            )
        self._messages = WorkerMessages(self._process.stdout)
        self._heard = 0.0
        self._pace.reach(self.stage, 0.0)

    def _end_of_stage(self, status: int) -> None:
        self._process = None
        self._messages.read_rest()
        now = time.monotonic()
        if status:
            message = f"{self.stage} failed with status {status}:\n{last_lines(self._errors())}"
            self._note(message)
            raise JobError(message)
        settings = cost_model.stage_settings(self.stage, self.spec)
        if self.stage == "render" and (seen := Brightness.read(self.layout.brightness)):
            settings["brightness"] = vars(seen)
            self._note(str(seen))
        seconds, before = now - self._start, {cost.name: cost.settings for cost in self._log.stages()}
        settings["wall_s"] = round(before.get(self.stage, {}).get("wall_s", 0.0) + seconds, 3)
        self._log.record(self.stage, seconds, self._messages.peak_mb, settings, resumed=True)
        self._note(f"{self.stage}: {seconds:.0f} s, {self._messages.peak_mb:.0f} MB")

    def _left_here(self) -> float:
        """Return seconds left in this stage."""
        if not self.stage:
            return 0.0
        if self._messages.total and self._messages.share != self._heard:
            self._pace.reach(self.stage, self._messages.share)
            self._heard = self._messages.share
        return self._pace.left_here or 0.0

    def _later(self) -> float:
        return sum(self._expected[stage] for stage in self._waiting)

    def _errors(self) -> Path:
        return self.layout.log(self.stage).with_suffix(".err")

    def _note(self, text: str) -> None:
        self.layout.hidden.mkdir(parents=True, exist_ok=True)
        with open(self.layout.job_log, "a", encoding="utf-8") as file:
            print(time.strftime("%Y-%m-%d %H:%M:%S"), text, file=file)


# ----------------------------------------------------------------
# The page of a finished dataset: pictures of every camera, what it holds, and what each stage cost.

SHOWN = 4  # frames per camera

PAGE = """<!doctype html>
<meta charset="utf-8"><title>{name}</title>
<style>
body {{ font: 15px/1.5 sans-serif; margin: 2em auto; max-width: 70em; background: #16181c; color: #ddd }}
table {{ border-collapse: collapse }} td, th {{ padding: .2em .8em; text-align: left; border-bottom: 1px solid #333 }}
img {{ height: 15em; margin: 2px }} code {{ color: #fb8 }}
</style>
<h1>{name}</h1>
<p>{summary}</p>
{pictures}
<h2>What it cost</h2>
<table><tr><th>stage<th>seconds<th>peak memory, MB</tr>{costs}</table>
<h2>What it holds</h2>
<table>{files}</table>
"""


FILES = {
    "dataset.json": "cameras, clock, splits; opened by <code>gof.dataset.Dataset.open</code>",
    "cameras/": "pictures, flame masks, linear EXR with depth and the flame alone",
    "static/": "the same views without the fire",
    "velocity.zarr": "velocity of the gas in m/s at every frame",
    "scene.blend": "the scene itself",
    "spec.json": "how it was made: <code>gof generate spec.json --out DIR</code> makes it again",
    ".cache/": "logs and the solver's cache; may be deleted",
}


def write_page(layout: Layout) -> None:
    """Write the page of a finished dataset; pictures are those of the dataset, not copies."""
    dataset, stages = DatasetDescription.read(layout.root), StageLog(layout.costs).stages()
    times = dataset.time_s
    shown = sorted({round(k * (len(times) - 1) / max(SHOWN - 1, 1)) for k in range(SHOWN)})
    page = PAGE.format(
        name=escape(dataset.name),
        summary=_summary(dataset, layout, stages),
        pictures="\n".join(_row(camera, shown, times) for camera in dataset.cameras),
        costs="".join(f"<tr><td>{escape(s.name)}<td>{s.seconds:.1f}<td>{s.peak_mb:.0f}</tr>" for s in stages),
        files="".join(f"<tr><td><code>{name}</code><td>{text}</tr>" for name, text in FILES.items()),
    )
    write_text(layout.report, page)


def _summary(dataset: DatasetDescription, layout: Layout, stages: tuple[StageCost, ...]) -> str:
    spec, first = SceneSpec.from_dict(dataset.spec), dataset.cameras[0]
    store = read_json(layout.velocity / "zarr.json")
    cells = " x ".join(map(str, store["shape"][1:4]))
    effects = ", ".join(dataset.effects) or "none"
    fire = dataset.provenance.get("fire")  # of another solver
    burns = f"{fire['name']} ({fire['solver']})" if fire else spec.fire.title
    exposed = next((cost.settings["brightness"] for cost in stages if "brightness" in cost.settings), None)
    flame = f" {str(Brightness(**exposed)).capitalize()}." if exposed else ""
    return (
        f"{escape(burns)} in {escape(spec.background.replace('_', ' '))}; "
        f"effects: {escape(effects)}. {len(dataset.time_s)} frames at {spec.clip.fps:g} per second, "
        f"{len(dataset.cameras)} cameras of {first.width} x {first.height} pixels, "
        f"velocity on {cells} cells of {1000 * store['attributes']['voxel_size']:.1f} mm.{flame}"
    )


def _row(camera: CameraEntry, frames: list[int], times: tuple[float, ...]) -> str:
    images = [(camera.static, "without fire")] + [(camera.rgb.format(frame=k), f"{times[k]:.3f} s") for k in frames]
    pictures = "".join(f'<img src="{escape(path)}" title="{text}" alt="{text}">' for path, text in images)
    return f"<h2>{escape(camera.name)}{' (evaluation)' if camera.role == 'eval' else ''}</h2><p>{pictures}</p>"


# ----------------------------------------------------------------
# A look into a spec's .blend by a Blender process of its own, before anything is made of it.

WRONG = 2  # exit status of the worker where the spec or its .blend is wrong


def scene_notes(spec: SceneSpec, python: list[str]) -> list[str]:
    """Return notes for the maker of the scene on its objects (`pure.bodies`); none without a .blend.

    Args:
        python: a command that runs the Python code given as its next argument, in a Blender without a window.
    Raises:
        SpecError: the .blend cannot be the surroundings, and why.
        JobError: the process failed.
    """
    if not spec.blend_file:
        return []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spec.json"
        scene_spec.save(spec, path)
        command = [*python, code("look", ["--spec", str(path)])]
        status, out, errors = _run(command, Path(folder))
    last = (errors if status else out).strip().splitlines()[-1:] or [""]
    if status == WRONG:
        raise SpecError(last[0])
    if status:
        raise JobError(f"looking into {spec.blend_file.path} failed with status {status}: {last[0]}")
    lines = [line for line in out.splitlines() if line.startswith('{"notes"')]
    return json.loads(lines[-1])["notes"]


def _run(command: list[str], folder: Path) -> tuple[int, str, str]:
    """Status, output and errors. The process ends with its standard input, hence with this one; a folder for files."""
    with (folder / "out").open("wb") as out, (folder / "errors").open("wb") as errors:
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=out, stderr=errors) as process:
            process.wait()
    texts = ((folder / name).read_text(encoding="utf-8", errors="replace") for name in ("out", "errors"))
    return process.returncode, *texts
