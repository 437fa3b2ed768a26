"""A function in a Python process of its own: its peak memory, its compiler and its Blender are then its own."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from typing import Any

from gof.host.processes import python_command

CODE = """\
import json, os, sys
from {module} import {name}
print(json.dumps({name}(*json.loads(sys.argv[1]))), flush=True)
os._exit(0)
"""  # Blender as a module cannot exit normally after a bake


def command(function: Callable, *arguments: Any) -> list[str]:
    """Return the command line that calls a module's function and prints what it returns, both as JSON."""
    module = function.__module__
    if module == "__main__":
        module = sys.modules["__main__"].__spec__.name  # of a script that was started with -m
    code = CODE.format(module=module, name=function.__name__)
    return python_command("-c", code, json.dumps(arguments))


def call(function: Callable, *arguments: Any) -> Any:
    """Call it there; whatever else it prints is left aside.

    Raises:
        RuntimeError: it failed; the message holds its last lines.
    """
    done = subprocess.run(command(function, *arguments), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(
            f"{function.__name__}{arguments} ended with status {done.returncode}:\n"
            f"{done.stdout[-2000:]}{done.stderr[-2000:]}"
        )
    return json.loads(done.stdout.splitlines()[-1])
