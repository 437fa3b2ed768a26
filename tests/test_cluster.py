"""The generator and the evaluator on a dask cluster of two worker processes."""

import json
from dataclasses import replace

import pytest

from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof_benchmark.commands import generate
from gof_blender.pure import spec as scene_spec
from tests.blender.runs import TOY
from tests.conftest import random_gaussians

pytestmark = pytest.mark.long

distributed = pytest.importorskip("distributed")


@pytest.fixture(scope="module")
def client():
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        client.wait_for_workers(2)
        yield client


@pytest.mark.blender
def test_the_generator_on_two_workers(client, tmp_path):
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    scene_spec.save(replace(TOY, name="cluster"), tmp_path / "spec.json")
    assert (
        generate.main(
            [str(tmp_path / "spec.json"), "--out", str(tmp_path / "data"), "--scheduler", client.scheduler.address]
        )
        == 0
    )
    dataset = Dataset.open(tmp_path / "data")
    assert all(dataset.image(camera, frame).any() for camera in range(3) for frame in range(5))
    costs = {stage["name"]: stage for stage in json.loads((tmp_path / "data" / "costs.json").read_text())["stages"]}
    assert {"bake", "render", "ground-truth", "finish"} <= set(costs)


def test_the_evaluator_on_two_workers(client, tiny_dataset, tmp_path):
    results = [random_gaussians(30, seed).save(tmp_path / f"{seed}.npz") for seed in range(4)]
    dataset = Dataset.open(tiny_dataset)
    futures = client.map(evaluate, results, dataset=dataset, pure=False)
    there = client.gather(futures)
    used = {name for names in client.who_has(futures).values() for name in names}
    assert len(used) == 2, "both workers had work"
    for result, scores in zip(results, there, strict=True):
        here = evaluate(result, dataset)
        assert scores.dve == here.dve and scores.psnr == pytest.approx(here.psnr, abs=1e-4)
