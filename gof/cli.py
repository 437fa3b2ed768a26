"""The `gof` command: names the commands, loads only the one that is asked for, prints errors people can act on."""

from __future__ import annotations

import errno
import importlib
import sys

from gof import __version__
from gof.errors import GofError

# name -> (module with main(argv), one line of help). This table is the only place where gof names the other rooms.
COMMANDS = {
    "demo": ("benchmark.demo", "make, reconstruct, score and show a small real fire (about 5 minutes on 2 cores)"),
    "generate": ("benchmark.generate", "scene spec -> simulated fire, three rendered videos, ground-truth velocity"),
    "static": ("gof.reconstruct.static.run", "videos of a fire -> dataset: fire-free plates, camera poses, frame times"),
    "background": ("gof.reconstruct.static.background", "the scene without fire as static Gaussians, for views no camera took"),
    "reconstruct": ("gof.reconstruct.run", "three videos -> transient flame Gaussians with velocities"),
    "evaluate": ("gof.evaluate.run", "result + ground truth -> DVE, PSNR, SSIM, and controls to compare with"),
    "convert": ("gof.io.convert", "any method's result -> .npz, .ply or .ftgs.ply in metres, seconds and m/s"),
    "leaderboard": ("gof.evaluate.leaderboard", "evaluated results side by side: table, stream plots, accuracy against time"),
    "study": ("benchmark.study", "accuracy against time, as tables and plots: of the DVE (dve), of the generator (generate)"),
    "import": ("benchmark.import_result", "result -> animated point cloud in a .blend, and a rendered preview"),
    "view": ("gof.view", "result in the browser, in 3D with a time slider; also while it is being optimised"),
    "capture": ("gof.capture.run", "the camera rig: LED board, frame times from footage, calibration, board masks"),
    "report": ("gof.report", "pictures, animation, scores and costs on one self-contained HTML page"),
    "doctor": ("gof.doctor", "check this machine: Blender, Mantaflow, Dr.Jit, CUDA, OpenEXR, disk, weights"),
}

DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)  # what a user's disk can do to a run

HELP = """\
gof {version} - Gaussians on Fire: three videos of a flame to transient 3D Gaussians with real velocities.

usage: gof COMMAND [OPTIONS]        gof COMMAND --help explains one command

{commands}

the whole loop, step by step:
  gof generate demo --out data/fire                 a dataset: pictures, cameras, velocity in m/s
  gof reconstruct data/fire --out out/fire          out/fire/result.ply and result.npz
  gof evaluate out/fire/result.npz --truth data/fire --out out/fire
  gof import out/fire/result.npz --dataset data/fire --blend out/fire/result.blend
  gof report out/fire --dataset data/fire           out/fire/report.html

Every command resumes what it finds half done, and writes its figures with --json FILE.
"""


def main(argv: list[str] | None = None) -> int:
    """Run one command. Returns the exit status: 0 done, 1 a named error, 2 wrong usage, 130 Ctrl-C."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help", "help"):
        lines = "\n".join(f"  {name:<12} {text}" for name, (_, text) in COMMANDS.items())
        print(HELP.format(version=__version__, commands=lines))
        return 0
    if argv[0] == "--version":
        print(f"gof {__version__}")
        return 0
    if argv[0] not in COMMANDS:
        print(f"gof: no command '{argv[0]}'; commands: {', '.join(COMMANDS)}", file=sys.stderr)
        return 2
    try:
        return importlib.import_module(COMMANDS[argv[0]][0]).main(argv[1:]) or 0
    except GofError as e:
        print(f"gof {argv[0]}: {e}", file=sys.stderr)
        return 1
    except OSError as e:
        if e.errno not in DISK:
            raise
        print(f"gof {argv[0]}: {e.filename or 'a file'}: {e.strerror}; finished work is kept: make room, or choose another folder, and run the same "
              "command again", file=sys.stderr)  # fmt: skip
        return 1
    except KeyboardInterrupt:
        print(f"\ngof {argv[0]}: stopped; finished work is kept, the same command resumes", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
