"""Rerun's catalogue of many recordings."""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from carom.display import keeper
from carom.display.viewer import Viewer
from carom.errors import RecordingError
from carom.physics.space import Space
from carom.recording.schema.header import SweepMember
from carom.runs.run import simulate
from needs import PICTURES
from page_requests import requests_of_pages
from small_scenes import pair

pytest.importorskip("datafusion")
from rerun.catalog import CatalogClient

from carom.display.catalog import catalog

pytestmark = pytest.mark.needs("datafusion")


def swept(folder: Path, restitution: float) -> Path:
    path = folder / f"restitution={restitution}.rrd"
    scene = pair(contact={"restitution": restitution}, time={"duration": 0.2})
    member = SweepMember(path.stem, {"contact.restitution": restitution, "seed": 0}, "carom sweep")
    simulate(Space(scene, threads=1), path, member=member)
    return path


def test_each_recording_is_a_row_with_what_varies_and_what_came_of_it(tmp_path: Path) -> None:
    paths = [swept(tmp_path, restitution) for restitution in (0.2, 0.8)]
    with catalog("bounces", paths) as address:
        server, _, entry = address.rpartition("/dataset/")
        assert server.startswith("rerun+http://127.0.0.1:")
        dataset = CatalogClient(server).get_dataset("bounces")
        assert str(dataset.id) == entry
        rows = dataset.segment_table().to_arrow_table()
    assert sorted(value for (value,) in rows["property:sweep:contact_restitution"].to_pylist()) == [0.2, 0.8]
    assert rows["property:outcome:outcome"].to_pylist() == [["completed"]] * 2


@pytest.mark.slow
@pytest.mark.needs(PICTURES)
def test_a_row_opens_in_the_viewer(tmp_path: Path) -> None:
    with catalog("bounces", [swept(tmp_path, 0.5)]) as address:
        dataset = CatalogClient(address.rpartition("/dataset/")[0]).get_dataset("bounces")
        (row,) = dataset.segment_ids()
        with Viewer("--headless", keep=(keeper.SHARED,)) as viewer:
            viewer.open(address)
            viewer.open(dataset.segment_url(row))
            viewer.until("open the row", 60.0, lambda: bool(viewer.client.get_state().views))
            assert row in (viewer.client.get_state().active_recording or "")


CATALOGUE = """
import sys
from pathlib import Path
from carom.lab.sweep import serve  # before libraries that start threads, as the command does
import carom.display.keeper as keeper

isolate = keeper.isolate
def checked():
    alone = isolate()
    import carom.lab.sweep.manifest as manifest
    import carom.display.viewer as catalogue

    class Window:  # in place of the viewer's
        def __init__(self, **_): pass
        def __enter__(self): return self
        def __exit__(self, *_): pass
        def open(self, address):
            print(address, alone, flush=True)
        def wait(self):
            sys.stdin.read()

    class Run:
        file = "runs/restitution=0.5.rrd"

    class Sweep:
        runs = [Run]

    catalogue.Viewer = Window
    manifest.read = lambda folder: Sweep
    return alone

keeper.isolate = checked
serve(Path())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="namespaces are Linux's")
def test_the_server_of_a_window_is_where_no_other_user_can_connect(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    swept(tmp_path / "runs", 0.5)
    with subprocess.Popen(
        [sys.executable, "-c", CATALOGUE],
        cwd=tmp_path,
        env=os.environ | {"DISPLAY": ":99"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as serving:
        assert serving.stdout is not None and serving.stdin is not None
        assert serving.stdout.readline() == "1 recordings\n", "no address, since nobody could use it"
        address, alone = serving.stdout.readline().split()
        if alone != "True":
            pytest.skip("this machine grants no namespaces")
        port = int(address.split("/")[2].rpartition(":")[2])
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=10)
        serving.stdin.close()
        assert serving.wait(60) == 0


@pytest.mark.skipif(sys.platform != "linux", reason="namespaces are Linux's")
def test_without_a_screen_only_calls_of_the_user_reach_the_server(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    swept(tmp_path / "runs", 0.5)
    screenless = {name: value for name, value in os.environ.items() if "DISPLAY" not in name}
    with subprocess.Popen(
        [sys.executable, "-u", "-c", CATALOGUE],
        cwd=tmp_path,
        env=screenless,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as serving:
        assert serving.stdout is not None
        try:
            line = serving.stdout.readline()
            if "for your own viewers" not in line:
                pytest.skip("this machine grants no namespaces")
            server, _, entry = line.split(" at ")[1].split(",")[0].rpartition("/dataset/")
            dataset = CatalogClient(server).get_dataset(tmp_path.name)
            assert str(dataset.id) == entry and len(dataset.segment_ids()) == 1
            port = int(server.rpartition(":")[2])
            for request in requests_of_pages(port)[::9]:
                with socket.create_connection(("127.0.0.1", port), timeout=10) as page:
                    with contextlib.suppress(ConnectionError):
                        page.sendall(request)
                    with contextlib.suppress(ConnectionResetError):
                        assert page.recv(1) == b"", request
            serving.send_signal(signal.SIGINT)
            assert serving.wait(60) == 0
        finally:
            serving.kill()


def test_a_catalog_names_missing_recordings(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"no recording at .*gone"), catalog("bounces", [tmp_path / "gone.rrd"]):
        pass
    with pytest.raises(RecordingError, match="no recordings yet"), catalog("bounces", []):
        pass
