"""`gof.render` loads what is asked for, and nothing before."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import gof.render


def loaded_by(code: str, *modules: str) -> str:
    watch = f"print([m for m in {modules} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", f"import sys\n{code}\n{watch}"], capture_output=True, text=True)
    return done.stdout.strip() or done.stderr


def test_importing_the_package_loads_nothing_heavy():
    assert loaded_by("import gof.render", "torch", "mitsuba", "drjit") == "[]"


def test_drawing_and_loss_need_neither_torch_nor_mitsuba():
    pytest.importorskip("drjit")
    code = "import gof.render as r; r.render_splats, r.l1_ssim"
    assert loaded_by(code, "torch", "mitsuba", "drjit") == "['drjit']"


def test_editors_see_the_names_that_are_loaded():
    """The imports for type checkers, the table of lazy names and `__all__` are one list."""
    tree = ast.parse(Path(gof.render.__file__).read_text())
    (block,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.name: node.module for node in block.body for alias in node.names}
    lazy = gof.render._MODULES
    assert seen == {name: f"gof.render.{module}" for name, module in lazy.items()}
    assert sorted(gof.render.__all__) == sorted(lazy)
    with pytest.raises(AttributeError, match="no attribute 'rendr'"):
        gof.render.rendr
