"""The commands that make scenes with Blender, and the studies; the entry point `gof.commands` adds them to `gof`."""

from gof.commands import Command

COMMANDS = {
    "demo": Command("gof_benchmark.commands.demo", "make, reconstruct, score and show a small real fire", "make"),
    "generate": Command("gof_benchmark.commands.generate", "scene -> fire, three videos, true velocity", "make"),
    "study": Command("gof_benchmark.commands.study", "accuracy against time of each part; ablations", "score"),
    "benchmark": Command("gof_benchmark.commands.benchmark", "GoF-Bench: enter it, check, rank", "score"),
    "import": Command("gof_benchmark.commands.import_result", "result -> .blend, and a rendered preview", "show"),
}
