"""What a script imports, in checkouts written here: stand-ins that are found, packages that are missed."""

import pytest

from gof.core.errors import GofError

pytest.importorskip("torch")
pytest.importorskip("drjit")
from gof.on_cpu.imports import missing, read_imports
from gof.on_cpu.launch import method_of

RENDER = """
from diff_gaussian_rasterization import GaussianRasterizationSettings, GaussianRasterizer
def render(a, b):
    {taken} = GaussianRasterizer(a)(means3D=b, means2D=b)
"""
TRAIN = """
import os, json
from scene import Scene
from utils.loss import ssim
import a_package_of_nobody.part
try:
    from a_nicety import Writer
except ImportError:
    pass
def later():
    import a_thing_for_later
"""
SCENE = "from .render import render\nfrom simple_knn._C import distCUDA2\nfrom hashgrid import Encoder\n"
FILES = {
    "train.py": TRAIN,
    "scene/__init__.py": SCENE,
    "scene/render.py": RENDER.format(taken="picture, radii, depth"),
    "utils/loss.py": "from math import exp\nfrom fused_ssim import fused_ssim\n",
    "hashgrid/__init__.py": "from hashencoder.backend import _backend\n",
    "hashencoder/backend.py": "raise RuntimeError('this would compile')\n",
    "unrelated.py": "import a_package_that_train_does_not_import\n",
}


@pytest.fixture
def checkout(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def test_imports_are_followed_from_file_to_file(checkout):
    found = read_imports(checkout / "train.py")
    names = {path.relative_to(checkout).as_posix() for path in found.files}
    assert names == {"train.py", "scene/__init__.py", "scene/render.py", "utils/loss.py", "hashgrid/__init__.py"}
    assert {"diff_gaussian_rasterization", "simple_knn._C", "fused_ssim", "hashencoder.backend"} <= found.others
    assert "a_package_of_nobody.part" in found.others
    assert missing({"os", "json.decoder", "a_package_of_nobody.part"}) == ["a_package_of_nobody"]


def test_a_method_that_is_not_listed_gets_stand_ins_and_hears_what_is_missing(checkout):
    method = method_of(None, checkout / "train.py")
    assert set(method.modules) == {"diff_gaussian_rasterization", "simple_knn._C", "fused_ssim", "hashencoder.backend"}
    assert method.modules["diff_gaussian_rasterization"]().GaussianRasterizer.depth
    assert method.unused == ("a_package_of_nobody.part",)
    assert "an error once it is used: a_package_of_nobody)" in method.title


@pytest.mark.parametrize("taken, depth", [("picture, radii", False), ("picture, radii, depth", True)])
def test_the_variant_is_the_one_that_the_code_unpacks(checkout, taken, depth):
    (checkout / "scene/render.py").write_text(RENDER.format(taken=taken))
    made = method_of(None, checkout / "train.py").modules["diff_gaussian_rasterization"]()
    assert made.GaussianRasterizer.depth is depth


def test_a_rasteriser_of_its_own_kind_is_refused(checkout):
    (checkout / "scene/render.py").write_text(RENDER.format(taken="a, b, c, d"))
    with pytest.raises(GofError, match=r"train.py: it takes \[4\] things .* 2 \(plain\)"):
        method_of(None, checkout / "train.py")
    (checkout / "scene/render.py").write_text("def (")
    with pytest.raises(GofError, match="render.py: not a Python file"):
        method_of(None, checkout / "train.py")
    with pytest.raises(GofError, match="no such script"):
        method_of("wu", checkout / "nothing.py")
