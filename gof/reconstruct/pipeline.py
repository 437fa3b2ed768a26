"""A dataset's videos to transient flame Gaussians: stages, each a function of what those before it found.

    see motion -> still scene -> flow field -> seeds -> fit -> save

The stages are in `gof.reconstruct.stages`; here is their order, and the checks before time is spent.
"""

from __future__ import annotations

import sys
from pathlib import Path

from gof.core.cameras import in_words, sizes_px
from gof.core.costs import StageLog
from gof.core.errors import GofError
from gof.core.files import only_run_in
from gof.core.time_left import LEAST_S, MachineLoad, Paces, TimeLeft, duration
from gof.dataset import Dataset
from gof.dataset.leaks import require_no_leaks, require_unleaked_work
from gof.reconstruct import memory, sanity, stages
from gof.reconstruct.forecast import ClipShape, expected_bytes, expected_parts
from gof.reconstruct.heldout import HeldOut
from gof.reconstruct.methods import METHODS
from gof.reconstruct.optical_flow import flow_method
from gof.reconstruct.settings import ReconstructionSettings, Until, require_stage
from gof.reconstruct.shrink import shrink

CROWDED = 1.3  # seconds of the clock for a CPU second, from which on a run says nothing of this machine's pace


def reconstruct(
    dataset: Dataset,
    settings: ReconstructionSettings,
    out: Path,
    until: Until = "result",
    flow_weights: Path | None = None,
    anyway: bool = False,
    overwrite: bool = False,
) -> stages.Reconstruction | None:
    """Run the stages up to `until`; a finished result is kept, an interrupted optimisation resumed.

    Args:
        dataset: as it was opened, at full size.
        out: folder of the reconstruction, for these settings alone.
        flow_weights: folder of a MEMFOF checkpoint, for the flow "memfof".
        anyway: go on where cameras, clocks, plates or memory look impossible.
        overwrite: replace a reconstruction with other settings; its files alone go, once this one is known to be
            possible.
    Returns:
        None when stopped before the result.
    Raises:
        GofError: `out` holds a reconstruction made with other settings, another run is at work there, the dataset has a
            single training frame, its cameras cannot have filmed one flame (`gof.reconstruct.sanity`), or this machine
            has too little memory; or see the stages.
        LeakError: the dataset's plates, or what lies in `out`, were made from a frame that is held out.
    """
    require_stage(until)
    require_no_leaks(dataset)
    with only_run_in(out):
        replaced = settings.is_replaced(out, overwrite)
        if not replaced:
            require_unleaked_work(out, dataset)
            finished = stages.Reconstruction.find(out)
            if finished is not None:
                return finished
        read = None if until == "result" else dataset.train_frames  # held-out pictures choose the step that is kept
        dataset.require_files(("rgb", "static"), ("train", "eval") if read is None else ("train",), read)
        small = shrink(dataset, settings.longest_side)
        flow = flow_method(settings.flow, flow_weights)
        _require_motion(small)
        _require_one_size(small, settings)
        method, machine = METHODS[settings.method], MachineLoad.measured_now()
        clip = ClipShape.of(small, method)
        parts = expected_parts(clip, settings)
        left = TimeLeft(Paces.known().expected_s(parts, machine))
        run = stages.ReconstructionRun(small, settings, method, flow, out, StageLog(out / "costs.json"), left)
        _require_possible(run, expected_bytes(clip, settings), anyway)
        if replaced:
            stages.remove_made(out)
        settings.claim(out)
        begun_before = run.log.path.exists()
        made = _run_stages(run, until)
        if made is not None and not begun_before:
            _learn(parts, left, machine)
        return made


def _run_stages(run: stages.ReconstructionRun, until: Until) -> stages.Reconstruction | None:
    observation = stages.see_motion(run)
    if until == "motion":
        return None
    still = stages.make_still_scene(run, observation)
    field = stages.make_flow_field(run, observation)
    if until == "flow-field":
        return None
    observation = observation.without_motion()  # half of a clip's memory
    memory.give_back()
    held_out = HeldOut(run.dataset, run.own(observation.static), near=field.voxels.voxel_size)
    light = stages.find_light(run, observation, field)
    seeds = stages.make_seeds(run, observation, still, field, light, held_out)
    if until == "seeds":
        return None
    memory.give_back()
    gaussians, plates, curve = stages.fit(run, observation, still, field, light, seeds, held_out)
    return stages.save(run, gaussians, plates, curve, held_out)


def _require_motion(dataset: Dataset) -> None:
    if len(dataset.train_frames) < 2:
        raise GofError(
            f"{dataset.path}: a single frame has no motion; at least 2 training frames are needed, "
            f"splits.train has {len(dataset.train_frames)}"
        )


def _require_one_size(dataset: Dataset, settings: ReconstructionSettings) -> None:
    """Raise GofError where a still scene of Gaussians would be drawn, and learned, beyond a smaller picture's edge."""
    sizes = sizes_px(dataset.cameras)
    if settings.scene == "gaussians" and len(sizes) > 1:
        raise GofError(
            f"{dataset.path}: its cameras' pictures differ in size ({in_words(sizes)}), and --scene gaussians wants "
            "one size; --scene plates takes them as they are"
        )


def _learn(parts: dict[str, float], left: TimeLeft, before: MachineLoad) -> None:
    """Keep what the parts took over what was expected of them; other programs' share is the mean of two probes.

    Nothing is learned from a crowded run: the probes do not say how crowded it was between them.
    """
    left.end()
    crowded = (before.crowded * MachineLoad.measured_now().crowded) ** 0.5
    if crowded > CROWDED:
        return
    paces = Paces.known()
    for part in (part for part in parts.keys() & left.took_s.keys() if parts[part] >= LEAST_S):
        paces = paces.with_run(part, left.took_s[part] / parts[part] / crowded)
    paces.keep()


def _require_possible(run: stages.ReconstructionRun, needed: float, anyway: bool) -> None:
    """Say how long it will take and how much memory, and what is wrong or odd, before the time is spent.

    Args:
        needed: bytes of memory.
    Raises:
        GofError: an input is impossible or the memory too small, and `anyway` is not set.
    """
    seconds = sum(run.left.expected_s.values())
    print(
        f"{run.settings.iterations} steps: about {duration(seconds)} in all on this machine as busy as it is now, and "
        f"{memory.in_words(needed)}",
        file=sys.stderr,
    )
    if len(run.dataset.cameras) == 1:
        print(
            "one camera: depth is a guess; it is assumed to stand over the world's origin, and to be as deep as wide",
            file=sys.stderr,
        )
    found = sanity.find_faults(run.dataset)
    for fault in found:
        print(f"warning: {fault.text}", file=sys.stderr)
    if not anyway:
        sanity.require_possible(found, run.dataset)
        memory.require(needed)
