"""Campaigns under bad stores, bad folders, crashing and hanging samples, two runs at once, Ctrl-C."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from patience import PATIENCE

import robustlab as rl
from robustlab.campaign import (
    CampaignSettings,
    Identity,
    Rows,
    Store,
    WorkerOptions,
    read_campaign,
    resume_campaign,
    run_campaign,
    saved_samples,
)
from robustlab.errors import DependencyMissing, EnvironmentFault, InputError, NoTrustworthyNumber

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def motor():
    return rl.plant("dc-motor", Kf=(4.8e-5, 0.35), R=(2.07, 0.1)).uncertain(outputs=["omega"])


@pytest.fixture(scope="module")
def folder(tmp_path_factory, motor):
    """A folder with the motor."""
    place = tmp_path_factory.mktemp("campaign")
    rl.save(place / "motor.h5", motor)
    return place


TASK = ("--input-value", "u=42", "--t-end", "0.1", "--points", "51", "--workers", "1")


def start(folder, *arguments):
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return subprocess.Popen(
        [sys.executable, "-m", "robustlab.cli.main", "campaign", *map(str, arguments)],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell's background jobs ignore Ctrl-C, and so would this child of one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )


def settings_of(n=300, **more):
    return CampaignSettings("peak-deviation", n, **{"u": {"u": 42.0}, "t_end": 0.1, "points": 51, **more})


def begun(path, motor, n=300, saved=64, **more):
    """A store of an unfinished campaign."""
    settings = settings_of(n, **more)
    store = Store.create(path, motor, settings)
    store.save(Rows(0, np.arange(float(saved)), np.zeros((saved, 2)), np.ones(saved)))
    store.close(finished=True)
    return path


# --- two runs, Ctrl-C, a dead owner ---------------------------------------------------------------------------------


def wait_until_saved(store, run):
    until = time.monotonic() + PATIENCE
    while time.monotonic() < until and run.poll() is None:
        try:
            if saved_samples(store)[0]:
                return
        except (InputError, EnvironmentFault):
            pass
        time.sleep(0.05)
    pytest.fail(f"nothing was saved: {run.communicate()}")


def test_a_second_run_is_rejected_ctrl_c_prints_the_command_to_resume_and_a_dead_pid_is_freed(folder, motor):
    store = folder / "long.sqlite"
    run = start(folder, "run", "motor.h5", *TASK, "-n", 1_000_000, "--store", store)
    wait_until_saved(store, run)
    with pytest.raises(EnvironmentFault, match="locked by another run"):
        resume_campaign(store)
    assert read_campaign(store).status == rl.Status.INCONCLUSIVE  # reading is free
    run.send_signal(signal.SIGINT)
    out, err = run.communicate(timeout=PATIENCE)
    saved, n = saved_samples(store)
    assert (run.returncode, out) == (130, "")
    assert err == f"interrupted: {saved} of {n} samples saved; resume with robustlab campaign resume {store}\n"
    run = start(folder, "resume", store, "--workers", 1)
    deadline = time.monotonic() + PATIENCE
    while saved_samples(store)[0] == saved:
        assert time.monotonic() < deadline
        assert run.poll() is None
        time.sleep(0.05)
    run.kill()
    run.communicate()


def test_more_than_one_percent_lost_stops(tmp_path, motor):
    store = Store.create(tmp_path / "s.sqlite", motor, settings_of())
    store.save(Rows(0, np.full(4, np.nan), np.zeros((4, 2)), np.ones(4), dict.fromkeys(range(4), "gone")))
    store.close()
    with pytest.raises(NoTrustworthyNumber, match="4 of 300 samples are lost") as caught:
        resume_campaign(tmp_path / "s.sqlite", workers=WorkerOptions(1))
    assert "sample 0: gone" in str(caught.value)


# --- what changed ---------------------------------------------------------------------------------------------------


def test_changed_settings_model_and_code_are_refused_by_name(tmp_path, motor):
    path = begun(tmp_path / "s.sqlite", motor)
    with pytest.raises(InputError, match=r"changed since sample 0 \(settings.seed: 0 -> 1\)") as caught:
        run_campaign(motor, settings_of(seed=1), path)
    assert "--restart" in str(caught.value)
    assert "another --store" in str(caught.value)
    stiffer = rl.plant("dc-motor", Kf=(4.8e-5, 0.30), R=(2.07, 0.1)).uncertain(outputs=["omega"])
    with pytest.raises(InputError, match=r"changed since sample 0 \(the uncertain model: "):
        run_campaign(stiffer, settings_of(), path)
    store = Store.open(path, write=True)
    old = store.identity
    older = Identity(old.model, old.settings, {**old.code, "numpy": "1.0"})
    store.put("identity", json.dumps(older.to_json()))
    store.put("hash", older.hash)
    store.close()
    with pytest.raises(InputError, match=r"changed since sample 0 \(code.numpy: 1.0 -> 2"):
        resume_campaign(path)
    assert saved_samples(path) == (64, 300)


def test_restart(tmp_path, motor):
    path = begun(tmp_path / "s.sqlite", motor, n=64)
    fresh = run_campaign(motor, settings_of(n=64), path, existing="restart", workers=WorkerOptions(1))
    assert (fresh.store, fresh.done) == (str(path), 64)
    assert fresh.worst < 63.0


# --- stores that are none -------------------------------------------------------------------------------------------


def test_a_file_that_is_no_store_is_rejected(tmp_path, motor):
    cases = {
        "missing.sqlite": "no such file",
        "folder.sqlite": "is a directory",
        "text.sqlite": r"not a campaign store \(first bytes 68 65 6c 6c\)",
        "other.sqlite": "an SQLite file, but no campaign of robustlab",
    }
    (tmp_path / "folder.sqlite").mkdir()
    (tmp_path / "text.sqlite").write_text("hello", encoding="utf-8")
    with closing(sqlite3.connect(tmp_path / "other.sqlite")) as db:
        db.execute("CREATE TABLE sample (idx)")
        db.commit()
    for name, text in cases.items():
        for call in (read_campaign, resume_campaign, saved_samples):
            with pytest.raises(InputError, match=text):
                call(tmp_path / name)
    assert not list(tmp_path.glob("*.lock"))


@pytest.mark.parametrize("existing", ["resume", "restart"])
def test_a_file_of_another_kind_is_never_overwritten(tmp_path, motor, existing):
    path = tmp_path / "precious.h5"
    rl.save(path, motor)
    before = path.read_bytes()
    with pytest.raises(InputError, match="not a campaign store"):
        run_campaign(motor, settings_of(), path, existing=existing)
    assert path.read_bytes() == before


def test_an_empty_file_is_begun_and_a_value_changed_after_the_end_is_noticed(tmp_path, motor):
    path = tmp_path / "s.sqlite"
    path.touch()
    assert run_campaign(motor, settings_of(n=64), path, workers=WorkerOptions(1)).done == 64
    with closing(sqlite3.connect(path)) as db:
        db.execute("UPDATE sample SET value = value * 1.0000001 WHERE idx = 5")
        db.commit()
    with pytest.raises(InputError, match="rows were changed after the campaign ended"):
        read_campaign(path)


@pytest.mark.parametrize("page", [1, 2, 3, None])
def test_a_damaged_page_and_a_truncated_store_are_named(tmp_path, motor, page):
    path = begun(tmp_path / "s.sqlite", motor, saved=200)
    data, size = bytearray(path.read_bytes()), 4096
    if page is not None:
        data[page * size : (page + 1) * size] = b"\xa5" * size
    path.write_bytes(data if page is not None else data[: len(data) // 2])
    with pytest.raises(InputError, match=r"s\.sqlite: damaged campaign store: "):
        read_campaign(path)


# --- the machine ----------------------------------------------------------------------------------------------------


def test_a_full_disk_keeps_saved_samples(tmp_path, motor):
    path = begun(tmp_path / "s.sqlite", motor, n=100_000)
    store = Store.open(path, write=True)
    (pages,) = store._db.execute("PRAGMA page_count").fetchone()
    store._db.execute(f"PRAGMA max_page_count={pages}")
    with pytest.raises(EnvironmentFault, match=r"s\.sqlite: .*full; the samples saved before are kept"):
        store.save(Rows(64, np.zeros(5000), np.zeros((5000, 2)), np.zeros(5000)))
    store.close()
    assert saved_samples(path) == (64, 100_000)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder(tmp_path, motor):
    path = begun(tmp_path / "s.sqlite", motor)
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(EnvironmentFault):
            resume_campaign(path)
        assert read_campaign(path).done == 64
    finally:
        tmp_path.chmod(0o700)


def test_a_worker_that_ends_ends_the_run_and_the_store_is_continued(tmp_path, motor, monkeypatch):
    monkeypatch.setattr("robustlab.campaign.runs._end_with_parent", os.abort)
    path = tmp_path / "s.sqlite"
    with pytest.raises(EnvironmentFault, match="a worker failed") as caught:
        run_campaign(motor, settings_of(), path, workers=WorkerOptions(1))
    assert f"robustlab campaign resume {path}" in str(caught.value)
    monkeypatch.undo()
    assert resume_campaign(path, workers=WorkerOptions(1)).done == 300


def test_the_missing_extra_is_named_with_its_command(tmp_path, motor, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(DependencyMissing, match=r"needs dask\.distributed") as caught:
        run_campaign(motor, settings_of(), tmp_path / "s.sqlite", workers=WorkerOptions(cluster="tcp://127.0.0.1:1"))
    assert "pip install 'robustlab[cluster]'" in str(caught.value)
    assert caught.value.exit_code == 5


@pytest.mark.parametrize("workers", [0, -1, 1.5, True])
def test_workers_are_a_whole_number(tmp_path, motor, workers):
    with pytest.raises(InputError, match="workers"):
        run_campaign(motor, settings_of(), tmp_path / "s.sqlite", workers=WorkerOptions(workers))
