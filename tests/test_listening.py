"""Nothing listens unless it is asked to, and then on loopback, to pages of its own."""

import re
import shutil
import socket
import subprocess
import urllib.error
import urllib.request

import psutil
import pytest

from tests.conftest import random_gaussians
from tests.test_docs import ROOT


def listening() -> set[tuple[str, int]]:
    """(address, port) of every socket on which this process waits for others."""
    connections = psutil.Process().net_connections(kind="inet")
    return {tuple(c.laddr) for c in connections if c.status == psutil.CONN_LISTEN}


def test_an_open_socket_is_seen():
    before = listening()
    with socket.create_server(("127.0.0.1", 0)) as server:
        assert listening() - before == {server.getsockname()}


def test_the_generators_own_cluster_opens_no_socket():
    from gof_benchmark.generator import graph

    before = listening()
    with graph.cluster(None, workers=2) as client:
        assert client.submit(sum, [1, 2]).result(timeout=30) == 3, "and it works"
        assert len(client.scheduler_info()["workers"]) == 2
        assert listening() == before


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    pytest.importorskip("viser")
    from gof.report.viewer import Viewer

    path = random_gaussians(20).save(tmp_path_factory.mktemp("view") / "result.npz")
    before = listening()
    viewer = Viewer(path, port=8590)
    yield viewer, listening() - before
    viewer.server.stop()


def get(port: int, **headers: str) -> int:
    request = urllib.request.Request(f"http://127.0.0.1:{port}/", headers=headers)
    try:
        return urllib.request.urlopen(request, timeout=20).status
    except urllib.error.HTTPError as e:
        return e.code


def upgrade(port: int, **headers: str) -> int:
    """Status of a request for a websocket."""
    import viser
    import websockets.exceptions
    from websockets.sync.client import connect

    try:
        with connect(
            f"ws://127.0.0.1:{port}", additional_headers=headers, subprotocols=[f"viser-v{viser.__version__}"]
        ):
            return 101
    except websockets.exceptions.InvalidStatus as e:
        return e.response.status_code


def test_the_viewer_listens_on_loopback_only(viewer):
    server = viewer[0].server
    assert viewer[1] == {("127.0.0.1", server.get_port())}


def test_a_foreign_page_gets_nothing(viewer):
    """Any page in the same browser may ask 127.0.0.1, under its own name (Origin) or one that it has bent (Host)."""
    port = viewer[0].server.get_port()
    own = f"http://localhost:{port}"
    assert get(port) == 200 and upgrade(port) == 101, "programs that send no origin"
    assert upgrade(port, Origin=f"http://127.0.0.1:{port}") == 101
    assert get(port, Host=f"localhost:{port}") == 200
    for origin in ("http://evil.example", "null", f"http://localhost:{port + 1}", f"{own}.evil.example"):
        assert upgrade(port, Origin=origin) == 403, origin
        assert get(port, Origin=origin) == 403, origin
    for host in ("rebind.evil.example", f"rebind.evil.example:{port}", f"127.0.0.1.evil.example:{port}", ""):
        assert get(port, Host=host) == 403, host


def test_no_page_can_publish_the_viewer(viewer, monkeypatch):
    import viser._viser as internals

    tunnels = []

    class Tunnel:
        def __init__(self, *args):
            tunnels.append(args)

        def on_disconnect(self, *args):
            pass

        def on_connect(self, *args):
            raise RuntimeError("a tunnel")

    monkeypatch.setattr(internals, "ViserTunnel", Tunnel)
    assert viewer[0].server.request_share_url() is None
    assert not tunnels
    theme = [m for m in messages(viewer[0].server) if type(m).__name__ == "ThemeConfigurationMessage"]
    assert theme and not any(message.show_share_button for message in theme)


def messages(server) -> list:
    """What every page that connects is told."""
    return list(server._websock_server._broadcast_buffer.message_from_id.values())


def test_a_host_that_was_asked_for_is_served_to_its_own_pages(monkeypatch):
    from gof.report.own_pages import is_own_page

    monkeypatch.setattr(socket, "gethostname", lambda: "Cluster7")
    assert is_own_page({"Host": "cluster7:8080", "Origin": "http://cluster7:8080"}, "0.0.0.0")
    assert is_own_page({"Host": "cluster7:8080"}, "cluster7")
    assert not is_own_page({"Host": "cluster7:8080", "Origin": "http://evil.example"}, "0.0.0.0")
    for host in ("127.0.0.1", "0.0.0.0"):
        assert not is_own_page({"Host": "rebind.example:8080", "Origin": "http://rebind.example:8080"}, host)
    assert is_own_page({"Host": "[::1]:8080", "Origin": "http://[::1]:8080"}, "::1")


def test_the_cluster_page_warns_first():
    first = "\n".join((ROOT / "docs" / "cluster.md").read_text().splitlines()[:6])
    assert "Warning" in first and "TLS" in first
    page = (ROOT / "docs" / "cluster.md").read_text()
    recipe = page.partition("```bash")[2].partition("```")[0]
    for line in recipe.splitlines():
        if "dask_scheduler" in line or "dask_worker" in line:
            assert "$TLS" in line and "--interface" in line, line


@pytest.mark.long
def test_a_scheduler_with_a_certificate_lets_in_who_holds_it(tmp_path):
    """The recipe's options, on loopback; without the certificate nobody gets in, and the way in is encrypted."""
    import distributed

    from gof.errors import GofError
    from gof_benchmark.generator import graph

    if not shutil.which("openssl"):
        pytest.skip("needs openssl")
    page = (ROOT / "docs" / "cluster.md").read_text()
    make = re.search(r"openssl req .*?(?=`)", page)[0].replace("~/.gof-tls", str(tmp_path))
    subprocess.run(make, shell=True, check=True, capture_output=True)
    cert, key = str(tmp_path / "cert.pem"), str(tmp_path / "key.pem")
    security = distributed.Security(
        require_encryption=True,
        tls_ca_file=cert,
        **{f"tls_{who}_cert": cert for who in ("scheduler", "worker", "client")},
        **{f"tls_{who}_key": key for who in ("scheduler", "worker", "client")},
    )
    with distributed.LocalCluster(
        n_workers=1, processes=False, protocol="tls://", host="127.0.0.1", security=security, dashboard_address=None
    ) as remote:
        address = remote.scheduler_address
        assert address.startswith("tls://127.0.0.1")
        with graph.cluster(address, 1, tmp_path) as client:
            assert client.submit(sum, [1, 2]).result(timeout=30) == 3
        for wrong in (address, address.replace("tls://", "tcp://")):
            with pytest.raises(GofError, match="no dask scheduler answers"), graph.cluster(wrong, 1):
                pass
        with pytest.raises(GofError, match=r"no cert\.pem and no key\.pem"), graph.cluster(address, 1, tmp_path / "x"):
            pass
