"""The commands that make scenes with Blender, and the studies; the entry point `gof.commands` adds them to `gof`."""

from gof.commands import Command

COMMANDS = {
    "demo": Command(
        "gof_benchmark.commands.demo",
        "make, reconstruct, score and show a small real fire (about 4 minutes on 2 cores)",
        10,
    ),
    "generate": Command(
        "gof_benchmark.commands.generate",
        "scene spec -> simulated fire, three rendered videos, ground-truth velocity",
        20,
    ),
    "benchmark": Command(
        "gof_benchmark.commands.benchmark",
        "GoF-Bench: frozen scenes that methods are compared on; submissions checked and ranked",
        85,
    ),
    "study": Command(
        "gof_benchmark.commands.study",
        "accuracy against time: of the DVE, the generator, the reconstruction; ablations",
        90,
    ),
    "import": Command(
        "gof_benchmark.commands.import_result",
        "result -> animated point cloud in a .blend, and a rendered preview",
        100,
    ),
}
