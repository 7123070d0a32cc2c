"""Campaigns on a Dask cluster: the same table as in one process, whatever workers and schedulers do."""

from __future__ import annotations

import json
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

import hexservo as hs
from hexservo.campaigns.engines import compute_remotely
from hexservo.campaigns.plan import load_plan
from hexservo.campaigns.store import new_record
from hexservo.run.publish import OutputError
from test_campaign_engine import FILE, digest_of
from test_cli import environment

pytest.importorskip("distributed")

# In a process without pytest's filter, which makes errors of warnings that Dask raises and handles itself.
LOST_WORKER = """
    import os, signal, sys
    import hexservo as hs
    from distributed import Client, LocalCluster

    def main():
        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            with Client(cluster) as client:
                processes = list(client.run(os.getpid).values())
            def kill(done, count):
                if done >= 200 and processes:
                    os.kill(processes.pop(), signal.SIGKILL)
                    processes.clear()
            result = hs.campaign(sys.argv[1], sys.argv[2], engine=cluster.scheduler_address, progress=kill,
                                 store_on_workers=sys.argv[4:] == ["shared"])
            print(len(result), result.complete, processes)

    if __name__ == "__main__":
        main()
"""
LOST_SCHEDULER = """
    import os, signal, subprocess, sys, time
    import hexservo as hs
    from hexservo.run.publish import OutputError

    def cluster(place):
        scheduler = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1",
                                      "--port", "0", "--no-dashboard", "--scheduler-file", place])
        worker = subprocess.Popen([sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", place,
                                   "--nthreads", "1", "--no-dashboard", "--no-nanny"])
        while not os.path.exists(place):
            time.sleep(0.05)
        import json
        return scheduler, worker, json.load(open(place))["address"]

    def main():
        scheduler, worker, address = cluster(sys.argv[3] + "/first.json")
        def kill(done, count):
            if done >= 300:
                scheduler.kill()
        try:
            hs.campaign(sys.argv[1], sys.argv[2], engine=address, progress=kill)
        except OutputError as error:
            print(error)
        worker.kill()
        print(len(hs.load_campaign(sys.argv[2])))
        scheduler, worker, address = cluster(sys.argv[3] + "/second.json")
        print(hs.campaign(sys.argv[1], sys.argv[2], engine=address).complete)
        worker.kill()
        scheduler.kill()

    if __name__ == "__main__":
        main()
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "out"
    assert hs.campaign(FILE, folder).complete
    return folder


def output_of_script(script: str, folder: Path, *more: str) -> list[str]:
    (folder / "campaign.yaml").write_text(load_plan(FILE).to_yaml(), encoding="utf-8")
    (folder / "script.py").write_text(textwrap.dedent(script), encoding="utf-8")
    arguments = [sys.executable, "script.py", "campaign.yaml", "out", str(folder), *more]
    run = subprocess.run(arguments, cwd=folder, capture_output=True, text=True, check=False, env=environment())
    assert run.returncode == 0, run.stderr
    return run.stdout.splitlines()


@pytest.mark.parametrize("more", [(), pytest.param(("shared",), marks=pytest.mark.slow)])
def test_a_killed_worker_changes_nothing(more: tuple[str, ...], whole: Path, tmp_path: Path) -> None:
    assert output_of_script(LOST_WORKER, tmp_path, *more) == ["1000 True []"]
    assert digest_of(tmp_path / "out") == digest_of(whole)


def test_a_worker_writes_into_the_folder_of_its_campaign_only(whole: Path, tmp_path: Path) -> None:
    plan = load_plan(FILE)
    record = new_record(plan)
    arguments = (json.dumps(plan.to_mapping()), record["campaign"], record["variant"], 1, 1)
    content, tally = compute_remotely(*arguments, None)
    chunk = whole / "chunks" / "000001.parquet"
    assert content == chunk.read_bytes()
    chunk.unlink()
    assert compute_remotely(*arguments, str(whole)) == (None, tally)
    assert chunk.read_bytes() == content
    other = tmp_path / "other"
    hs.campaign(FILE | {"stream": 5}, other, runs=1)
    for folder in (other, tmp_path / "nowhere"):
        with pytest.raises(OutputError, match="expected a folder that every worker shares, got none of this"):
            compute_remotely(*arguments, str(folder))
    assert not (tmp_path / "nowhere").exists()


def test_workers_that_write_need_a_cluster(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="store_on_workers: expected the engine dask or tcp://host:port, got local"):
        hs.campaign(FILE, tmp_path / "out", store_on_workers=True)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_killed_scheduler_loses_nothing(whole: Path, tmp_path: Path) -> None:
    lost, kept, complete = output_of_script(LOST_SCHEDULER, tmp_path)
    assert lost.startswith("engine: expected a scheduler that runs, got: ")
    assert 300 <= int(kept) < 1000
    assert complete == "True"
    assert digest_of(tmp_path / "out") == digest_of(whole)


def test_an_engine_that_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="engine: expected local, dask, or the address of a Dask scheduler as tcp://"):
        hs.campaign(FILE, tmp_path / "out", engine="dsak")
    assert not (tmp_path / "out").exists()


def test_an_installation_without_dask(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OutputError, match=r'expected an installation with Dask: pip install "hexservo\[cluster\]"'):
        hs.campaign(FILE, tmp_path / "out", engine="dask")
