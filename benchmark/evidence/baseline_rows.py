"""Rows of other methods beside ours on scenes of GoF-Bench, trained by their own code on this machine's CPU.

    python -m gof_benchmark.evidence.baseline_rows WORK/standard OUT --wu DIR --yang DIR --freetime DIR \
        [--grid4d DIR] [--deformable DIR] [--scenes jet logs foam_two_burners] [--ours gof ...] \
        [--steps 3000] [--python THEIRS/bin/python]

Takes about two hours a scene. Needs checkouts of the other methods.

Every scene is seen in smaller pictures, every method is trained for the same number of steps with the settings that its
authors give for a scene of this kind, schedules shortened in proportion; then ours: with the flow prior, without, and
`--method paper` for as many steps, and once more for as many CPU seconds as the slowest of the others took. Each
becomes a submission in OUT/submissions and is checked; all that are there are scored into OUT/board, and scene by scene
into OUT/SCENE.md. Rows are made in turn, each on all scenes, the cheap ones first. Finished work is not done again,
so it may be stopped and started as one likes, or made in parts: others' rows are those whose checkout is given, ours
those of `--ours`. THEIRS is a Python with the packages of docs/baselines.md.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.costs import Costs, StageCost, StageLog
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.core.records import write_record
from gof.dataset import Dataset
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult
from gof.evaluate.scores import Scores
from gof.evaluate.submission import SCORES, Submission
from gof.evaluate.training_curve import FILE, TrainingCurve
from gof.host.processes import python_command
from gof_benchmark.views import shrunk

FIGURES = ("gaussians", "train_s", "memory_mb", "l2", "cos_sim", "inside_l2", "inside_cos", "eve_l2")
FIGURES += ("eve_cos", "psnr_flame", "ssim_flame", "psnr")
PLATE = ("psnr_flame", "ssim_flame", "psnr")  # of them the plate alone has
SHOWN = ("zero", "constant", "height_mean")


def table(submissions: list[Path], scene: str) -> str:
    """Markdown: a line for each submission that has the scene (means over its runs), then the trivial baselines.

    The last column is by how much the mean training loss fell from the fourth fifth of the steps to the last. Trivial
    baselines are on the Gaussians of the first flame alone, where there is one: a whole scene's are mostly its room.

    Args:
        submissions: folders (`gof.evaluate.submission`); what their scores.json say is taken as it is.
    """
    headings = [COLUMNS[key].heading for key in FIGURES]
    lines = [f"| {scene} | {' | '.join(headings)} | last fall of the loss |", "|---|" + "---:|" * (len(FIGURES) + 1)]
    shown: list[EvaluatedResult] = []
    for submission in map(Submission.open, submissions):
        folders = submission.runs.get(scene, ())
        about = replace(submission.method, train_seconds=None, memory_mb=None)  # of the run, not of the mean scene
        runs = [EvaluatedResult.of(folder, about, Scores.read(folder / SCORES)) for folder in folders]
        if runs:
            cells = [_mean(key, runs) for key in FIGURES]
            lines.append(f"| {submission.name} | {' | '.join(cells)} | {_fall(folders[0])} |")
            shown.append(runs[0])
    if shown:
        whose = next((run for run in shown if run.scores.import_.over_plates), shown[0])
        lines += [*_trivial_lines(whose.scores), "", f"Trivial baselines: on the Gaussians of {whose.name}."]
    return "\n".join(lines) + "\n"


def _mean(key: str, runs: list[EvaluatedResult]) -> str:
    found = [COLUMNS[key].value(run) for run in runs]
    return _cell(key, None if None in found else float(np.mean(found)))


def _fall(run: Path) -> str:
    return f"{100 * TrainingCurve.read(run / FILE).last_fall:.0f} %" if (run / FILE).is_file() else ""


def _trivial_lines(scores: Scores) -> list[str]:
    """Return the trivial baselines' lines: pooled over frames as the methods' own figures are."""
    known = {
        name: {"l2": trivial_baseline.l2, "cos_sim": trivial_baseline.cos_sim}
        for name, trivial_baseline in scores.trivial_baselines.items()
    }
    eve = None if scores.dve is None else scores.dve.eve
    if eve is not None and "constant" in known:
        known["constant"] |= {"eve_l2": eve.baselines["constant"].l2, "eve_cos": eve.baselines["constant"].cos_sim}
    rows = {f"trivial: {name}": known[name] for name in SHOWN if name in known}
    rows["trivial: fire-free background"] = {key: getattr(scores, f"{key}_plate") for key in PLATE}
    return [f"| {name} | {' | '.join(_cell(key, of.get(key)) for key in FIGURES)} | |" for name, of in rows.items()]


def _cell(key: str, figure: float | None) -> str:
    kind = COLUMNS[key].format
    return "" if figure is None else format(round(figure) if kind == "d" else figure, kind)


VIEWS = ("dnerf", "points", "hypernerf", "freetimegs", "nerfds")
GIVEN = {"others": ["poses", "starting points"], "ours": ["poses", "plates"]}
AUTHORS = {
    "wu": "Guanjun Wu et al.",
    "yang": "Zeyu Yang et al.",
    "freetime": "the authors of FreeTimeGsVanilla",
    "grid4d": "Jiawei Xu et al.",
    "deformable": "Ziyi Yang et al.",
}
OURS = {  # name in the submission's folder: (name of the row, options, what it knew before)
    "gof": ("gof", (), ["the flow prior, learned on the dev fires"]),
    "gof_no_prior": ("gof without the flow prior", ("--no-flow-prior",), []),
    "gof_paper": ("gof, --method paper", ("--method", "paper"), []),
    "gof_long": ("gof, as long as the slowest", (), ["the flow prior, learned on the dev fires"]),
}
# The cheap ones first.
ROWS = ("freetime", "gof", "gof_no_prior", "gof_paper", "yang", "wu", "deformable", "grid4d", "gof_long")


@dataclass(frozen=True)
class BaselineRows:
    """Train other methods by their own code and ours beside them, check them, and score them on one page."""

    suite: tyro.conf.Positional[Path]
    """A size of the suite that `gof benchmark make` made: WORK/standard."""
    out: tyro.conf.Positional[Path]
    """Folder for all of it."""
    scenes: tuple[str, ...] = ("jet", "logs", "foam_two_burners")
    """For the suite, of one split."""
    wu: Path | None = None
    """Checkout of hustvl/4DGaussians."""
    yang: Path | None = None
    """Checkout of fudan-zvg/4d-gaussian-splatting."""
    freetime: Path | None = None
    """Checkout of raiscui/FreeTimeGsVanilla."""
    grid4d: Path | None = None
    """Checkout of JiaweiXu8/Grid4D."""
    deformable: Path | None = None
    """Checkout of ingra14m/Deformable-3D-Gaussians."""
    steps: int = 3000
    """For every training, one picture each."""
    max_size: int = 160
    """For the pictures, px."""
    ours: tuple[str, ...] = tuple(OURS)
    """Which rows of ours, or none; `gof_long` takes as long as the slowest of the others that are there."""
    seeds: int = 1
    """Runs of each of ours; the others have one, with the seed that their scripts set."""
    split: str = "test"
    """For the scenes: test or dev."""
    python: Path = Path(sys.executable)
    """The Python that has the other methods' packages."""


@dataclass(frozen=True)
class BaselineTraining:
    """Command lines, run in turn, of which the one with `--curve` trains; what comes out, and how it is added.

    `result`: where several files match its name, the one of the last step.   `options`: what its files do not say, as
    options of `gof convert`.
    """

    commands: tuple[tuple[str, ...], ...]
    result: Path
    options: tuple[str, ...] = ()
    settings: dict[Path, str] = field(default_factory=dict)


# ---------------------------------------------------------------- the methods: their settings, their command lines


def wu(config: BaselineRows, data: Path, out: Path) -> BaselineTraining:
    """`arguments/hypernerf/default.py` at fewer steps, a fifth of them coarse; temporal resolution half the frames."""
    steps, fine = config.steps, config.steps * 4 // 5
    share, count = fine / 14_000, len(Dataset.open(data).times_s)
    settings = f"""ModelHiddenParams = dict(
    kplanes_config={{"grid_dimensions": 2, "input_coordinate_dim": 4, "output_coordinate_dim": 16,
                     "resolution": [64, 64, 64, {count // 2}]}},
    multires=[1, 2, 4], defor_depth=1, net_width=128,
    plane_tv_weight=0.0002, time_smoothness_weight=0.001, l1_time_planes=0.0001, render_process=False)
OptimizationParams = dict(
    iterations={fine}, coarse_iterations={steps - fine}, batch_size=1, opacity_reset_interval=300000,
    position_lr_max_steps={round(20_000 * share)}, densify_from_iter={round(500 * share)},
    densify_until_iter={round(10_000 * share)})
"""
    script, start = config.wu / "train.py", ("-m", "gof", "baseline", "--method", "wu")
    train = (
        *start,
        "--curve",
        f"{out}/curve.csv",
        f"{script}",
        "-s",
        f"{data}/hypernerf",
        "--model_path",
        f"{out}/model",
    )
    train += ("--configs", f"{out}/settings.py", "--save_iterations", f"{fine}", "--test_iterations", "10000000")
    export = (*start, "--trajectory", f"{out}/wu.npz", f"{script}", f"{out}/model", f"{data}")
    commands = (train + ("--expname", "x"), export)
    return BaselineTraining(commands, out / "wu.npz", settings={out / "settings.py": settings})


def yang(config: BaselineRows, data: Path, out: Path) -> BaselineTraining:
    """`configs/dnerf/*.yaml` at fewer steps, one picture a step, pictures as large as they are."""
    steps, share = config.steps, config.steps / 30_000
    settings = f"""gaussian_dim: 4
time_duration: [0.0, 1.0]
num_pts: 300_000
num_pts_ratio: 1.0
rot_4d: True
force_sh_3d: False
batch_size: 1
exhaust_test: False
ModelParams: {{sh_degree: 3, source_path: "{data}", model_path: "{out}/model", images: "images", resolution: 1,
  white_background: False, data_device: "cuda", eval: True, extension: ".png", num_extra_pts: 0, loaded_pth: "",
  frame_ratio: 1, dataloader: False}}
PipelineParams: {{convert_SHs_python: False, compute_cov3D_python: False, debug: False, env_map_res: 0,
  env_optimize_until: 1000000000, env_optimize_from: 0, eval_shfs_4d: True}}
OptimizationParams: {{iterations: {steps}, position_lr_init: 0.00016, position_t_lr_init: -1.0,
  position_lr_final: 0.0000016, position_lr_delay_mult: 0.01, position_lr_max_steps: {steps}, feature_lr: 0.0025,
  opacity_lr: 0.05, scaling_lr: 0.005, rotation_lr: 0.001, percent_dense: 0.01, lambda_dssim: 0.2,
  thresh_opa_prune: 0.005, densification_interval: 100, opacity_reset_interval: 3000,
  densify_from_iter: {round(500 * share)}, densify_until_iter: {round(15_000 * share)}, densify_grad_threshold: 0.0002,
  densify_grad_t_threshold: 0.0002 / 40, densify_until_num_points: -1, final_prune_from_iter: -1,
  sh_increase_interval: {max(1, round(1000 * share))}, lambda_opa_mask: 0.0, lambda_rigid: 0.0, lambda_motion: 0.0}}
"""
    train = ("-m", "gof", "baseline", "--method", "yang", "--curve", f"{out}/curve.csv", f"{config.yang}/train.py")
    train += ("--config", f"{out}/settings.yaml", "--test_iterations", "-1", "--save_iterations", f"{steps}")
    options = ("--time-unit", f"{duration(data)}")
    return BaselineTraining((train,), out / f"model/chkpnt{steps}.pth", options, {out / "settings.yaml": settings})


def freetime(config: BaselineRows, data: Path, out: Path) -> BaselineTraining:
    """Return its `default_keyframe_small`; starting points by its own script.

    It writes nothing at a step whose frame it was not given (one in eight is held out), hence the last eight steps.
    """
    count, steps, view = len(Dataset.open(data).times_s), config.steps, data / "freetimegs"
    script = "src/combine_frames_fast_keyframes.py"
    start = (f"{config.freetime}/{script}", "--input-dir", f"{view}/triangulation", "--output-path", f"{out}/start.npz")
    start += ("--frame-start", "0", "--frame-end", f"{count - 1}", "--keyframe-step", "5", "--sample-ratio", "0.25")
    train = ("-m", "gof", "baseline", "--method", "freetime", "--without-lpips", "--curve", f"{out}/curve.csv")
    train += (f"{config.freetime}/src/simple_trainer_freetime_4d_pure_relocation.py", "default_keyframe_small")
    train += ("--data-dir", f"{view}", "--init-npz-path", f"{out}/start.npz", "--result-dir", f"{out}/model")
    train += ("--start-frame", "0", "--end-frame", f"{count}", "--max-steps", f"{steps}", "--save-steps")
    train += tuple(f"{step}" for step in range(steps - 7, steps + 1))
    train += ("--eval-steps", "10000000", "--lambda-perc", "0", "--disable-viewer", "--render-traj-n-frames", "2")
    options = ("--time-unit", f"{duration(data)}", "--world", f"{view}/sparse/0")
    return BaselineTraining((start, train), out / "model/ckpts/ckpt_*.pt", options)


def grid4d(config: BaselineRows, data: Path, out: Path) -> BaselineTraining:
    """`arguments/hypernerf/vrig_*.py` at fewer steps, in a box of 1.6 m around the origin: what is outside stands
    still."""
    steps, share = config.steps, config.steps / 30_000
    settings = f"""grid_args = dict(
    canonical_num_levels=16, canonical_level_dim=2, canonical_base_resolution=16, canonical_desired_resolution=2048,
    canonical_log2_hashmap_size=19, deform_num_levels=32, deform_level_dim=2, deform_base_resolution=16,
    deform_desired_resolution=[256, 256, 64], deform_log2_hashmap_size=19, bound=1.6)
network_args = dict(depth=1, width=256, directional=True)
grid_lr_scale, network_lr_scale = 50.0, 1.0
lambda_spatial_tv, spatial_downsample_ratio, spatial_perturb_range = 1.0, 0.1, 1e-3
lambda_temporal_tv, temporal_downsample_ratio, temporal_perturb_range = 1.0, 1.0, [1e-2, 1e-2, 1e-2, 0.0]
warm_up, opacity_reset_interval = 0, 3000
densify_from_iter, densify_until_iter = {round(500 * share)}, {round(12_000 * share)}
deform_lr_max_steps = position_lr_max_steps = {steps}
"""
    more = ("--conf", f"{out}/settings.py")
    return _deformed("grid4d", config.grid4d, config, data, out, more, {out / "settings.py": settings})


def deformable(config: BaselineRows, data: Path, out: Path) -> BaselineTraining:
    """Return its own defaults at fewer steps."""
    share = config.steps / 40_000
    schedule = {"warm_up": 3000, "densify_from_iter": 500, "densify_until_iter": 15_000}
    schedule |= {"position_lr_max_steps": 30_000, "deform_lr_max_steps": 40_000}
    more = tuple(word for name, at in schedule.items() for word in (f"--{name}", f"{round(at * share)}"))
    return _deformed("deformable", config.deformable, config, data, out, ("--eval", *more), {})


def _deformed(
    name: str,
    checkout: Path | None,
    config: BaselineRows,
    data: Path,
    out: Path,
    more: tuple[str, ...],
    settings: dict[Path, str],
) -> BaselineTraining:
    """Train on the `nerfds` view and export, for the two methods whose network stands beside their Gaussians."""
    script, start = f"{checkout}/train.py", ("-m", "gof", "baseline", "--method", name)
    train = (*start, "--curve", f"{out}/curve.csv", script, "-s", f"{data}/NeRF/nerfds", "-m", f"{out}/model", *more)
    train += ("--iterations", f"{config.steps}", "--save_iterations", f"{config.steps}", "--test_iterations", "-1")
    export = (*start, "--trajectory", f"{out}/{name}.npz", script, f"{out}/model", f"{data}")
    return BaselineTraining((train, export), out / f"{name}.npz", settings=settings)


OTHERS = {"wu": wu, "yang": yang, "freetime": freetime, "grid4d": grid4d, "deformable": deformable}


def duration(data: Path) -> float:
    """Return the length of the clip, s."""
    times = Dataset.open(data).times_s
    return float(times[-1] - times[0])


# ---------------------------------------------------------------- trainings and what they cost


def measured(words: list[str], log: Path) -> StageCost:
    """Run a command in its log's folder: CPU seconds and peak memory. Raises GofError: it failed."""
    print(" ".join(words), flush=True)
    with log.open("a") as file:
        process = subprocess.Popen(words, stdout=file, stderr=subprocess.STDOUT, cwd=log.parent)
        _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise GofError(f"{words[1:5]} ended with status {process.returncode}; its words are in {log}")
    return StageCost("CPU", usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


def train_other(config: BaselineRows, name: str, data: Path, out: Path) -> None:
    """Train a method, and put it into its submission with its curve and what it cost."""
    training = OTHERS[name](config, data, out / name / data.name)
    folder = out / "submissions" / name / data.name
    if (folder / "scores.json").is_file():
        return
    work = fresh(out / name / data.name)
    log = work / "log.txt"
    for path, text in training.settings.items():
        path.write_text(text)
    costs = [measured([f"{config.python}", *words], log) for words in training.commands]
    result = last_of(training.result)
    if training.options:
        measured(python_command("-m", "gof", "convert", f"{result}", *training.options), log)
    add(result, data, folder, ("--trained-on", "train", "--curve", f"{work}/curve.csv"), log, costs)
    lines = log.read_text().splitlines()
    origin = next(line for line in lines if line.startswith("gof baseline: ")).removeprefix("gof baseline: ")
    head, _, licence = origin.rpartition("; licence: ")
    title, _, commit = head.partition(", commit ")
    about = {"name": f"{title}, {config.steps} steps", "made_by": "CPU re-run", "authors": [AUTHORS[name]]}
    about |= {
        "code": "its own, by gof baseline (docs/baselines.md)",
        "commit": commit or "not known",
        "licence": licence,
    }
    say(folder.parent, about | {"given": GIVEN["others"], "prior": []})


def last_of(result: Path) -> Path:
    """Return the file of that name, or of the files that match it the one that was written last."""
    return max(result.parent.glob(result.name), key=lambda path: path.stat().st_mtime_ns, default=result)


def train_ours(config: BaselineRows, name: str, data: Path, out: Path, seed: int) -> None:
    """Reconstruct, and put it into its submission with what it cost."""
    title, options, prior = OURS[name]
    folder = out / "submissions" / name / data.name / f"seed_{seed}"
    if (folder / "scores.json").is_file():
        return
    steps = config.steps if name != "gof_long" else equal_steps(config, data, out)
    work = fresh(out / name / data.name / f"seed_{seed}")
    log = work / "log.txt"
    words = python_command(*"-m gof reconstruct".split(), f"{data}", "--out", f"{work}/result", "--preset", "preview")
    words += ["--steps", f"{steps}", "--seed", f"{seed}", *options]
    costs = [measured(words, log)]
    add(work / "result", data, folder, (), log, costs)
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
    about = {"name": title if name == "gof_long" else f"{title}, {steps} steps", "authors": ["the authors of gof"]}
    about |= {"code": "gof reconstruct --preset preview", "commit": commit.stdout.strip() or "not known"}
    say(folder.parent.parent, about | {"licence": "as gof", "given": GIVEN["ours"], "prior": prior})


def equal_steps(config: BaselineRows, data: Path, out: Path) -> int:
    """Return steps of ours that take as many CPU seconds as the slowest of the others took on this scene."""
    runs = [out / "submissions" / name / data.name for name in OTHERS]
    theirs = [seconds(run) for run in runs if (run / "costs.json").is_file()]
    ours = seconds(out / "submissions/gof" / data.name / "seed_0")
    return round(config.steps * max(theirs, default=ours) / ours)


def seconds(run: Path) -> float:
    return sum(stage.seconds for stage in StageLog(run / "costs.json").stages())


def fresh(folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)  # half a training, of this script
    folder.mkdir(parents=True)
    return folder


def add(result: Path, data: Path, run: Path, options: tuple[str, ...], log: Path, costs: list[StageCost]) -> None:
    """`gof benchmark add`; costs.json then says CPU seconds, which others on the machine do not change."""
    shutil.rmtree(run, ignore_errors=True)
    submission, words = (run.parent, ()) if run.name == data.name else (run.parent.parent, ("--run", run.name))
    command = python_command("-m", "gof", "benchmark", "add", f"{result}", f"{submission}", "--dataset", f"{data}")
    measured([*command, *words, *options], log)
    peak = max(cost.peak_mb for cost in costs)
    total = StageCost("CPU", sum(cost.seconds for cost in costs), peak)
    write_record(run / "costs.json", Costs((total,), total.seconds))


def say(submission: Path, about: dict) -> None:
    """method.json: the seconds are the mean of the runs that are there."""
    runs = [seconds(path.parent) for path in submission.rglob("costs.json")]
    peaks = [stage.peak_mb for path in submission.rglob("costs.json") for stage in StageLog(path).stages()]
    more = {"hardware": "one thread of a CPU, shared: CPU seconds", "random": True}
    more |= {"train_seconds": sum(runs) / len(runs), "memory_mb": max(peaks)}
    write_json(submission / "method.json", json.loads(json.dumps(about | more)))


def main(argv: list[str] | None = None) -> None:
    """Train, add, check, score."""
    config = tyro.cli(BaselineRows, prog="python -m gof_benchmark.evidence.baseline_rows", args=argv)
    paths = {name: getattr(config, name) for name in ("suite", "out", *OTHERS)}
    if strange := [name for name in config.ours if name not in OURS]:
        raise GofError(f"--ours {' '.join(strange)}: there are {', '.join(OURS)}")
    config = replace(config, **{name: path.resolve() for name, path in paths.items() if path is not None})
    small = config.out / "pictures" / config.suite.resolve().name
    rows = [name for name in ROWS if name in config.ours or getattr(config, name, None)]
    for scene in config.scenes:
        if not all((small / scene / made).is_dir() for made in ("freetimegs/sparse", "NeRF/nerfds")):
            shutil.rmtree(small / scene, ignore_errors=True)
            words = [f"{config.suite / scene}", f"{small / scene}", "--max-size", f"{config.max_size}"]
            shrunk.main([*words, "--views", *VIEWS])
    for name in rows:
        for scene in config.scenes:
            if name in OTHERS:
                train_other(config, name, small / scene, config.out)
                continue
            for seed in range(config.seeds):
                train_ours(config, name, small / scene, config.out, seed)
    submissions = config.out / "submissions"
    for name in rows:
        words = ["check", f"{submissions / name}", f"{small}"]
        subprocess.run(python_command("-m", "gof", "benchmark", *words), check=False)
    finished = [submissions / name for name in ROWS if (submissions / name / "method.json").is_file()]
    for scene in config.scenes:
        (config.out / f"{scene}.md").write_text(table(finished, scene), encoding="utf-8")
        print(table(finished, scene))
    words = ["score", *map(str, finished), f"{small}", "--out", f"{config.out / 'board'}", "--scenes", config.split]
    subprocess.run(python_command("-m", "gof", "benchmark", *words), check=True)


if __name__ == "__main__":
    main()
