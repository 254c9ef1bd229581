"""A campaign on a Dask cluster of two workers gives the samples of a local one, and survives the death of a worker."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from patience import PATIENCE

import robustlab as rl
from robustlab.campaign import TILE, CampaignSettings, Evaluator, Store, saved_samples
from robustlab.errors import RobustlabError

pytest.importorskip("distributed")

ROOT = Path(__file__).parents[2]
N = 2000


def launch(folder, *words):
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "DASK_DISTRIBUTED__ADMIN__LOW_LEVEL_LOG_LENGTH": "0"}
    with (folder / "log.txt").open("ab") as log:
        command = [sys.executable, "-m", *map(str, words)]
        return subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=log, text=True)


@pytest.fixture
def cluster(tmp_path):
    """Address of a scheduler with two workers, and the process of the first."""
    file = tmp_path / "scheduler.json"
    options = ("--scheduler-file", file)
    running = [launch(tmp_path, "distributed.cli.dask_scheduler", "--port", 0, "--no-dashboard", *options)]
    try:
        until = time.monotonic() + PATIENCE
        while not file.exists() or not file.read_text(encoding="utf-8").strip():
            assert time.monotonic() < until, (tmp_path / "log.txt").read_text(encoding="utf-8")
            time.sleep(0.05)
        for _ in range(2):
            words = f"--nthreads 1 --no-dashboard --no-nanny --memory-limit 0 --local-directory {tmp_path}".split()
            running.append(launch(tmp_path, "distributed.cli.dask_worker", *options, *words))
        yield json.loads(file.read_text(encoding="utf-8"))["address"], running[1]
    finally:
        for process in reversed(running):
            process.terminate()
        for process in running:
            try:
                process.communicate(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.communicate()


@pytest.mark.slow
def test_same_samples_as_local_though_a_worker_dies(cluster, tmp_path):
    address, worker = cluster
    motor = rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1)).uncertain(outputs=["omega"])
    rl.save(tmp_path / "motor.h5", motor)
    settings = CampaignSettings("peak-deviation", N, u={"u": 42.0}, t_end=0.1, points=51)
    words = f"--input-value u=42 --t-end 0.1 --points 51 -n {N} --json --store cluster.sqlite".split()
    run = launch(tmp_path, "robustlab.cli.main", "campaign", "run", "motor.h5", *words, "--cluster", address)
    until = time.monotonic() + PATIENCE
    saved = 0
    while not saved and run.poll() is None and time.monotonic() < until:
        try:
            saved = saved_samples(tmp_path / "cluster.sqlite")[0]
        except RobustlabError:
            time.sleep(0.02)
    worker.send_signal(signal.SIGKILL)
    out, _ = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, (tmp_path / "log.txt").read_text(encoding="utf-8")
    result = json.loads(out)
    assert (result["done"], result["lost"], result["status"]) == (N, 0, "converged")
    evaluator = Evaluator(motor, settings)
    local = evaluator.rows(0, -(-N // TILE) * TILE).values  # the same bits, computed here
    store = Store.open(tmp_path / "cluster.sqlite")
    assert [row.value for row in store.samples()] == local.tolist()
    store.close()
    assert result["worst"] == local.max()
