"""`gof baseline` as a user runs it: look-alike trainers of our own, and real checkouts where given."""

import csv
import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import DataFormatError

torch = pytest.importorskip("torch")
pytest.importorskip("drjit")
from gof.on_cpu.export import clock_of  # noqa: E402

TRAINERS = Path(__file__).parent / "trainers"
ROOT = Path(__file__).parents[2]
# Written here because the libraries themselves are heavy: what the stand-ins of ours take hold of in them.
PACKAGES = {
    "gsplat/__init__.py": "from gsplat.rendering import rasterization\n",
    "gsplat/rendering.py": "def rasterization(*args, **kwargs):\n    raise RuntimeError('needs CUDA')\n",
    "gaussian_renderer/__init__.py": "from .diff_gaussian_rasterization import *\n",
}


@pytest.fixture
def run(tmp_path):
    for name, text in PACKAGES.items():
        (tmp_path / "packages" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "packages" / name).write_text(text)

    if not find_spec("torchvision"):  # imported by the two that train with it, and not used here
        (tmp_path / "vision/torchvision").mkdir(parents=True)
        (tmp_path / "vision/torchvision/__init__.py").write_text("")

    def start(*words, packages=True):
        paths = [os.environ.get("PYTHONPATH", ""), str(ROOT)]
        if packages:
            paths += [str(tmp_path / "packages")]
        if packages and "gsplat" not in words:
            paths += [str(tmp_path / "vision")]
        done = subprocess.run(
            [sys.executable, "-m", "gof", "baseline", *map(str, words)],
            capture_output=True,
            text=True,
            cwd=tmp_path,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
            check=False,
        )
        return done.returncode, done.stdout, done.stderr

    return start


@pytest.mark.long
@pytest.mark.parametrize(
    "method, trainer, options",
    [("wu", "with_depth", []), ("yang", "spacetime", []), ("gsplat", "with_gsplat", ["--without-lpips"])],
)
def test_a_look_alike_trains(run, tmp_path, method, trainer, options):
    words = ["--method", method, "--curve", tmp_path / "curve.csv", *options, TRAINERS / f"{trainer}.py"]
    code, out, err = run(*words)
    assert code == 0, err
    assert "trained 60 steps" in out and "licence" in out
    rows = list(csv.DictReader((tmp_path / "curve.csv").open()))
    assert [int(row["step"]) for row in rows] == list(range(10, 61, 10))
    assert float(rows[-1]["loss"]) < float(rows[0]["loss"]) and 0 < int(rows[-1]["gaussians"]) <= 300


@pytest.mark.long
def test_without_the_launcher_the_same_trainer_needs_cuda(tmp_path):
    done = subprocess.run(
        [sys.executable, str(TRAINERS / "with_depth.py")], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert done.returncode == 1 and "ModuleNotFoundError" in done.stderr


WORDS = """
import torch
assert torch.zeros(2, device="cuda").device.type == "cpu" and torch.zeros(2, device=0).device.type == "cpu"
assert torch.ones(2).to("cuda:1", torch.float64).dtype == torch.float64
assert torch.ones(2).to(torch.device("cuda"), non_blocking=True).cuda(non_blocking=True).pin_memory().sum() == 2
assert torch.nn.Linear(2, 2, device="cuda").cuda().to("cuda").weight.device.type == "cpu"
assert torch.tensor([1], device=torch.device("cuda", 0)).type("torch.cuda.FloatTensor").dtype == torch.float32
assert torch.ones(2).to("meta").device.type == "meta"

class Twice(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x):
        return 2 * x
    @staticmethod
    def backward(ctx, g):
        return g * torch.full((1,), 2.0, device="cuda")  # inside the backward pass too

x = torch.ones(3, device="cuda", requires_grad=True)
Twice.apply(x).sum().backward()
assert x.grad.tolist() == [2, 2, 2]
with torch.cuda.stream(torch.cuda.Stream()), torch.cuda.device(0):
    torch.cuda.synchronize()
free, total = torch.cuda.mem_get_info()
assert 0 < free <= total and torch.cuda.get_device_properties(0).total_memory == total
loader = torch.utils.data.DataLoader([1, 2, 3], num_workers=4, pin_memory=True, persistent_workers=True, shuffle=True)
assert loader.num_workers == 0 and len(list(loader)) == 3

def optimised(**choice):
    x = torch.nn.Parameter(torch.ones(7))
    optimizer = torch.optim.Adam([{"params": [x], "lr": 0.1, "name": "x"}], lr=0.0, eps=1e-15, **choice)
    for k in range(5):
        x.grad = (k + 1) * torch.linspace(-1, 1, 7)
        optimizer.step()
    return x.detach(), bool(optimizer.defaults["fused"])

(quick, fused), (plain, left) = optimised(), optimised(foreach=False)
assert fused and not left and (quick - plain).abs().max() < 1e-6
import sys
print("arguments", sys.argv[1:], __name__)
"""


@pytest.mark.long
def test_cuda_is_the_cpu_and_arguments_reach_the_script(run, tmp_path):
    script = tmp_path / "words.py"
    script.write_text(WORDS)
    code, out, err = run("--method", "3dgs", script, "--method", "x", "-s", "data", packages=False)
    assert code == 0, err
    assert "arguments ['--method', 'x', '-s', 'data'] __main__" in out
    script.write_text("import torch\ntorch.cuda.graphs_of_mine(3)\n")
    code, _, err = run("--method", "3dgs", script, packages=False)
    assert code == 1 and "graphs_of_mine" in err


@pytest.mark.long
def test_what_is_missing_is_named(run, tmp_path):
    code, _, err = run("--method", "3dgs", tmp_path / "nothing.py")
    assert code == 1 and "no such script" in err
    code, _, err = run("--method", "nobody", tmp_path / "nothing.py")
    assert code == 2 and "freetime" in err
    script = tmp_path / "restart.py"
    script.write_text("import os, sys\nos.execv(sys.executable, [sys.executable, 'train.py'])\n")
    code, _, err = run("--method", "wu", script)
    assert code == 1 and "its loss is NaN" in err
    code, _, err = run("--method", "yang", "--trajectory", tmp_path / "t.npz", script, tmp_path, tmp_path)
    assert code == 1 and "give them to gof evaluate" in err


@pytest.mark.long
def test_nothing_of_gof_imports_this_room():
    """It replaces PyTorch's functions for the whole process."""
    from tools.import_graph import all_imports, modules

    found = {
        name
        for name, path in modules().items()
        if not name.startswith("gof.on_cpu")
        for target, _ in all_imports(name, path)
        if target.startswith("gof.on_cpu")
    }
    assert not found


def test_wus_clock_is_that_of_the_layout():
    """Its HyperNeRF reader ends at 1, its "multiple view" reader a frame before; of others nothing is known."""
    assert clock_of(Path("data/hypernerf"), 5).tolist() == [0, 0.25, 0.5, 0.75, 1]
    assert clock_of(Path("/elsewhere/multipleview"), 5).tolist() == pytest.approx([0, 0.2, 0.4, 0.6, 0.8])
    with pytest.raises(DataFormatError, match="none of the views hypernerf, nerfds, multipleview"):
        clock_of(Path("data/dynerf"), 5)


# ---- real checkouts --------------------------------------------------------------------------------------------------


def checkout(name: str) -> Path:
    path = os.environ.get(f"GOF_BASELINE_{name}")
    if not path:
        pytest.skip(f"GOF_BASELINE_{name} is not set to a checkout (docs/baselines.md)")
    return Path(path)


@pytest.fixture(scope="module")
def views(tmp_path_factory) -> Path:
    """A made-up fire in every layout: a bright blob that rises before a wall and a floor."""
    from tests.on_cpu.made_up_fire import write

    return write(tmp_path_factory.mktemp("fire") / "fire")


def unchanged(folder: Path) -> bool:
    done = subprocess.run(
        ["git", "-C", str(folder), "diff", "--quiet", "--diff-filter=d", "HEAD"], capture_output=True, check=False
    )
    return done.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["multipleview", "hypernerf"])
def test_4dgs_of_wu(run, views, tmp_path, layout):
    code_folder = checkout("WU")
    config = tmp_path / "short.py"
    config.write_text(
        "ModelHiddenParams = dict(no_do=False, no_dshs=False, multires=[1, 2], net_width=32)\n"
        "OptimizationParams = dict(dataloader=True, iterations=40, coarse_iterations=20, batch_size=1)\n"
    )
    script, model = code_folder / "train.py", tmp_path / "model"
    words = ["-s", views / layout, "--model_path", model, "--configs", config]
    words += ["--port", 6031, "--expname", "x", "--save_iterations", 40]
    code, out, err = run("--method", "wu", "--curve", tmp_path / "c.csv", script, *words, packages=False)
    assert code == 0 and "no file changed" in out, err[-3000:]
    losses = [float(row["loss"]) for row in csv.DictReader((tmp_path / "c.csv").open())]
    assert losses[-1] < losses[0]
    saved = tmp_path / "wu.npz"
    code, out, err = run("--method", "wu", "--trajectory", saved, script, model, views, packages=False)
    assert code == 0, err[-3000:]
    from gof.io.importers import read_result

    trajectory = read_result(saved).gaussians
    step = trajectory.time_s[1] - trajectory.time_s[0]
    centre = (trajectory.position[2:] - trajectory.position[:-2]) / (2 * step)
    assert np.abs(trajectory.velocity).max() > 0
    # Half-frame differences of a young network agree with tiny ones to a part of the speed, no more.
    error = np.linalg.norm(trajectory.velocity[1:-1] - centre) / np.linalg.norm(centre)
    assert error < 0.5 and unchanged(code_folder)


READER = """
import json, sys
import numpy as np
from scene.neural_3D_dataset_NDC import Neural3D_NDC_Dataset
read = Neural3D_NDC_Dataset(sys.argv[1], "train", 1.0, time_scale=1, eval_index=0)
picture, (R, T), time = read[2]
found = {"count": len(read), "focal": read.focal[0], "time": time}
found |= {"R": np.asarray(R).tolist(), "T": np.asarray(T).tolist()}
json.dump(found | {"shape": list(picture.shape), "bright": float(picture.max())}, open(sys.argv[2], "w"))
"""


HYPER_READER = """
import json, sys
import numpy as np
from scene.hyper_loader import Load_hyper_data
found = {}
for split in ("train", "test"):
    read = Load_hyper_data(sys.argv[1], 0.5, False, split=split)
    found[split] = [
        (one.time, one.FovX, one.FovY, one.R.tolist(), one.T.tolist(), list(one.image.shape)) for one in read
    ]
json.dump(found, open(sys.argv[2], "w"))
"""


@pytest.mark.slow
def test_wus_hypernerf_reader_keeps_held_out_frames_out(run, views, tmp_path):
    """His own class: pictures that train and those that do not, their times, poses and fields of view."""
    from gof.dataset import Dataset

    script = checkout("WU") / "train.py"
    reader = tmp_path / "reader.py"
    reader.write_text(f"import sys\nsys.path.insert(0, {str(script.parent)!r})\n{HYPER_READER}")
    code, _, err = run("--method", "wu", reader, views / "hypernerf", tmp_path / "read.json", packages=False)
    assert code == 0, err[-3000:]
    read, dataset = json.loads((tmp_path / "read.json").read_text()), Dataset.open(views)
    last = len(dataset.times_s) - 1
    for split, frames in (("train", dataset.train_frames), ("test", dataset.test_frames)):
        assert sorted(entry[0] for entry in read[split]) == pytest.approx(
            sorted(k / last for k in frames for _ in "123")
        )
    for number, (_, across, down, R, T, shape) in enumerate(read["train"][:3]):
        camera = dataset.cameras[number]
        np.testing.assert_allclose(np.array(R).T, camera.world_to_camera[:3, :3], atol=1e-9)
        np.testing.assert_allclose(T, camera.world_to_camera[:3, 3], atol=1e-9)
        assert shape == [3, camera.height, camera.width]
        half = np.tan([across / 2, down / 2]) * camera.K[0, 0]
        np.testing.assert_allclose(half, [camera.width / 2, camera.height / 2])


@pytest.mark.slow
def test_wus_dynerf_reader_reads_the_published_form(run, views, tmp_path):
    """His own class: the world from camera 1, the field of view, time over 300 pictures."""
    from gof.dataset import Dataset

    script = checkout("WU") / "train.py"
    reader = tmp_path / "reader.py"
    reader.write_text(f"import sys\nsys.path.insert(0, {str(script.parent)!r})\n{READER}")
    code, _, err = run("--method", "wu", reader, views / "n3v", tmp_path / "read.json", packages=False)
    assert code == 0, err[-3000:]
    read, dataset = json.loads((tmp_path / "read.json").read_text()), Dataset.open(views)
    camera = dataset.cameras[0]
    assert read["count"] == 3 * len(dataset.times_s) and read["shape"] == [3, 1014, 1352] and read["bright"] > 0.5
    assert read["time"] == pytest.approx(2 / 300)
    np.testing.assert_allclose(np.array(read["R"]).T, camera.world_to_camera[:3, :3], atol=1e-9)
    np.testing.assert_allclose(read["T"], camera.world_to_camera[:3, 3], atol=1e-9)
    assert read["focal"] == pytest.approx(1352 * 2 * camera.K[0, 0] / 216)  # 48x80, doubled, in 216x162


@pytest.mark.slow
@pytest.mark.parametrize("method, options", [("grid4d", ["--conf"]), ("deformable", ["--eval", "--warm_up", 10])])
def test_a_network_beside_its_gaussians(run, views, tmp_path, method, options):
    """Grid4D with its own hash encoder over our stand-in, and Deformable-3DGS: trained, and sampled as they move."""
    from gof.io.importers import read_result

    code_folder = checkout(method.upper())
    if method == "grid4d":
        (tmp_path / "short.py").write_text("warm_up = 10\ndeform_lr_max_steps = position_lr_max_steps = 80\n")
        options = [*options, tmp_path / "short.py"]
    script, model = code_folder / "train.py", tmp_path / "model"
    words = ["-s", views / "NeRF/nerfds", "-m", model, *options, "--iterations", 80, "--save_iterations", 80]
    words += ["--test_iterations", -1]
    code, out, err = run("--curve", tmp_path / "c.csv", script, *words, packages=False)  # seen from what it imports
    assert code == 0 and "simple_knn._C" in out, err[-3000:]
    losses = [float(row["loss"]) for row in csv.DictReader((tmp_path / "c.csv").open())]
    assert losses[-1] < losses[0] and unchanged(code_folder)
    saved = tmp_path / "moved.npz"
    code, out, err = run("--method", method, "--trajectory", saved, script, model, views, packages=False)
    assert code == 0, err[-3000:]
    trajectory = read_result(saved).gaussians
    assert trajectory.position.shape[0] == 15 and np.abs(trajectory.velocity).max() > 0
    if method == "grid4d":  # the other's encodes time up to 2^9: young, its derivative is noise between half frames
        step = trajectory.time_s[1] - trajectory.time_s[0]
        centre = (trajectory.position[2:] - trajectory.position[:-2]) / (2 * step)
        assert np.linalg.norm(trajectory.velocity[1:-1] - centre) / np.linalg.norm(centre) < 0.8


@pytest.mark.slow
def test_4dgs_of_yang(run, views, tmp_path):
    from gof.io.importers import ImportOptions, read_result

    code_folder = checkout("YANG")
    config = tmp_path / "short.yaml"
    config.write_text(YANG_SETTINGS.format(data=views, model=tmp_path / "model"))
    script = code_folder / "train.py"
    words = ["--config", config, "--test_iterations", -1, "--save_iterations", 40]
    code, out, err = run("--method", "yang", "--curve", tmp_path / "c.csv", script, *words, packages=False)
    assert code == 0 and "no file changed" in out, err[-3000:]
    losses = [float(row["loss"]) for row in csv.DictReader((tmp_path / "c.csv").open())]
    assert losses[-1] < losses[0] and unchanged(code_folder)
    result = read_result(tmp_path / "model" / "chkpnt40.pth", ImportOptions(time_unit_s=0.07))
    assert result.method == "yang" and len(result.gaussians) > 500


@pytest.mark.slow
def test_freetimegs_vanilla(run, views, tmp_path):
    from gof.io.importers import ImportOptions, read_result

    code_folder = checkout("FREETIME")
    source = views / "freetimegs"
    combine, start = code_folder / "src/combine_frames_fast_keyframes.py", tmp_path / "start.npz"
    frames = ["--frame-start", 0, "--frame-end", 7, "--keyframe-step", 3]
    words = ["--input-dir", source / "triangulation", "--output-path", start, *frames, "--sample-ratio", 0.2]
    subprocess.run([sys.executable, str(combine), *map(str, words)], check=True, capture_output=True)
    script = code_folder / "src/simple_trainer_freetime_4d_pure_relocation.py"
    words = [
        "default_keyframe_small",
        "--data-dir",
        source,
        "--init-npz-path",
        start,
        "--result-dir",
        tmp_path / "model",
    ]
    words += ["--start-frame", 0, "--end-frame", 8, "--max-steps", 120, "--eval-steps", 500, "--save-steps", 120]
    words += ["--lambda-perc", 0, "--disable-viewer", "--render-traj-n-frames", 2]
    code, out, err = run(
        "--method", "freetime", "--without-lpips", "--curve", tmp_path / "c.csv", script, *words, packages=False
    )
    assert code == 0 and "no file changed" in out, err[-3000:]
    losses = [float(row["loss"]) for row in csv.DictReader((tmp_path / "c.csv").open())]
    assert losses[-1] < losses[0] and unchanged(code_folder)
    options = ImportOptions(world=source / "sparse/0", time_unit_s=0.07)
    result = read_result(tmp_path / "model/ckpts/ckpt_119.pt", options)
    assert len(result.gaussians) > 500


YANG_SETTINGS = """
gaussian_dim: 4
time_duration: [0.0, 1.0]
num_pts: 300000
num_pts_ratio: 1.0
rot_4d: True
force_sh_3d: False
batch_size: 1
exhaust_test: False
ModelParams: {{sh_degree: 1, source_path: "{data}", model_path: "{model}", images: "images", resolution: 1,
  white_background: False, data_device: "cuda", eval: True, extension: ".png", num_extra_pts: 0, loaded_pth: "",
  frame_ratio: 1, dataloader: False}}
PipelineParams: {{convert_SHs_python: False, compute_cov3D_python: False, debug: False, env_map_res: 0,
  env_optimize_until: 1000000000, env_optimize_from: 0, eval_shfs_4d: True}}
OptimizationParams: {{iterations: 40, densify_from_iter: 500, densify_until_iter: 0}}
"""
