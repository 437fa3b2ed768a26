"""The command line that `gof baseline` starts in a process of its own."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from gof.core.errors import GofError


def main() -> int:
    """Run the script, or export what it trained; its own exit status, 1 for an error of ours."""
    from gof.on_cpu.baseline_methods import METHODS
    from gof.on_cpu.launch import export, launch, method_of, provenance

    rows = [(name, f"{m.title} ({m.repository})" if m.commit else m.title) for name, m in METHODS.items()]
    listed = "\n".join(f"  {name:<10} {title}" for name, title in rows)
    parser = argparse.ArgumentParser(
        prog="gof baseline",
        description="Run public Gaussian-splatting research code, unmodified, without CUDA: your checkout, its own "
        "script and arguments. docs/baselines.md has what each method needs.",
        epilog=f"methods:\n{listed}\n\nOptions of ours come before SCRIPT; all after it is the script's.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
    )
    parser.add_argument(
        "--method", choices=METHODS, help="whose code the script is of, below. Default: seen from what it imports"
    )
    parser.add_argument("--curve", type=Path, metavar="FILE", help="CSV to write the loss over steps and seconds to")
    parser.add_argument("--without-lpips", action="store_true", help="LPIPS, whose weights are fetched, is left out")
    parser.add_argument(
        "--trajectory",
        type=Path,
        metavar="FILE",
        help="do not run SCRIPT: write what it trained as gof-trajectory/1; ARGS are the training's output folder and "
        "the dataset (methods whose motion is a network's)",
    )
    parser.add_argument("script", type=Path, metavar="SCRIPT")
    parser.add_argument("arguments", nargs=argparse.REMAINDER, metavar="ARGS")
    options = parser.parse_args()
    script = options.script
    try:
        method = method_of(options.method, script)
        print(f"gof baseline: {method.title}, {provenance(method, script)}; licence: {method.licence}", flush=True)
        if options.trajectory:
            if len(options.arguments) != 2:
                parser.error("--trajectory FILE SCRIPT needs the training's output folder and the dataset, no more")
            trained, dataset = map(Path, options.arguments)
            export(method, script, trained, dataset, options.trajectory)
        else:
            launch(method, script, options.arguments, options.curve, options.without_lpips)
    except GofError as e:
        print(f"gof baseline: {e}", file=sys.stderr)
        return 1
    return 0


sys.exit(main())
