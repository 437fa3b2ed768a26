"""Nothing listens unless it is asked to, and then on loopback, to pages of its own."""

import re
import shutil
import socket
import subprocess
import urllib.error
import urllib.request

import psutil
import pytest

from gof.commands.cli import main
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


def test_the_generators_own_workers_open_no_socket():
    from gof_benchmark.generator.workers import workers_for

    before = listening()
    with workers_for(None, workers=2) as there:
        assert there.submit(sum, [1, 2]).result(timeout=30) == 3, "and it works"
        assert listening() == before


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    pytest.importorskip("viser")
    from gof.look.viewer import Viewer

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
    from gof.look.own_pages import is_own_page

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


@pytest.fixture(scope="module")
def certificate(tmp_path_factory):
    """The folder that the recipe's own command makes."""
    if not shutil.which("openssl"):
        pytest.skip("needs openssl")
    folder = tmp_path_factory.mktemp("tls")
    page = (ROOT / "docs" / "cluster.md").read_text()
    make = re.search(r"openssl req .*?(?=`)", page)[0].replace("~/.gof-tls", str(folder))
    subprocess.run(make, shell=True, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def scheduler(certificate):
    """A scheduler that lets in who holds the certificate; and its address."""
    import distributed

    cert, key = str(certificate / "cert.pem"), str(certificate / "key.pem")
    security = distributed.Security(
        require_encryption=True,
        tls_ca_file=cert,
        **{f"tls_{who}_cert": cert for who in ("scheduler", "worker", "client")},
        **{f"tls_{who}_key": key for who in ("scheduler", "worker", "client")},
    )
    with distributed.LocalCluster(
        n_workers=1, processes=False, protocol="tls://", host="127.0.0.1", security=security, dashboard_address=None
    ) as remote:
        assert remote.scheduler_address.startswith("tls://127.0.0.1")
        yield remote


@pytest.fixture
def connected(monkeypatch):
    """Address and certificate of each client that `gof generate` makes; in place of a fire, two numbers are added."""
    from gof_benchmark.generator import graph

    seen = []

    class Sum:
        def __init__(self, spec, layout, workers, log):
            self.workers = workers

        def run(self):
            assert self.workers.submit(sum, [1, 2], priority=1).result(timeout=30) == 3
            seen.append((self.workers.client.scheduler.address, self.workers.client.security))

    monkeypatch.setattr(graph, "Generation", Sum)
    return seen


@pytest.mark.long
def test_a_scheduler_with_a_certificate_lets_in_who_holds_it(certificate, scheduler, connected, tmp_path):
    """From the command line to the encrypted connection; the certificate and its key are what let it in."""
    address = scheduler.scheduler_address
    words = ["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "d"), "--scheduler", address]
    assert main([*words, "--tls", str(certificate)]) == 0
    reached, security = connected[0]
    assert reached == address and security.require_encryption
    assert security.tls_client_cert == str(certificate / "cert.pem")


@pytest.mark.long
def test_who_holds_another_certificate_stays_out(certificate, scheduler, connected, tmp_path, capsys):
    make = "openssl req -x509 -newkey rsa:3072 -nodes -days 1 -subj /CN=other -keyout key.pem -out cert.pem"
    subprocess.run(make, shell=True, check=True, capture_output=True, cwd=tmp_path)
    words = ["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "d")]
    assert main([*words, "--scheduler", scheduler.scheduler_address, "--tls", str(tmp_path)]) == 1
    assert "no dask scheduler answers" in capsys.readouterr().err
    assert not connected


REFUSED = {
    "an address without encryption": (["--scheduler", "tcp://127.0.0.1:9"], "not encrypted"),
    "an address without a scheme": (["--scheduler", "127.0.0.1:9"], "not encrypted"),
    "an address of web sockets": (["--scheduler", "ws://127.0.0.1:9"], "not encrypted"),
    "no scheduler": ([], "give its address too"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_certificate_that_would_protect_nothing_is_refused(case, certificate, connected, tmp_path, capsys):
    """Before anything is connected or written."""
    options, why = REFUSED[case]
    words = ["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "d"), "--tls", str(certificate)]
    assert main([*words, *options]) == 1
    said = capsys.readouterr().err
    assert "--tls" in said and why in said and "Traceback" not in said
    assert not (tmp_path / "d").exists() and not connected


def test_a_folder_without_a_certificate_is_named(certificate, tmp_path, capsys):
    words = ["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "d"), "--scheduler", "tls://127.0.0.1:9"]
    assert main(words) == 1
    assert "give --tls FOLDER" in capsys.readouterr().err
    assert main([*words, "--tls", str(tmp_path)]) == 1
    assert f"{tmp_path}: has no cert.pem and no key.pem" in capsys.readouterr().err
    shutil.copy(certificate / "cert.pem", tmp_path / "cert.pem")
    (tmp_path / "key.pem").write_text("no key")
    assert main([*words, "--tls", str(tmp_path)]) == 1
    assert f"{tmp_path}: cert.pem and key.pem are no certificate" in capsys.readouterr().err
    subprocess.run("openssl genrsa -aes256 -passout pass:word -out key.pem 2048", shell=True, check=True, cwd=tmp_path)
    assert main([*words, "--tls", str(tmp_path)]) == 1, "and nobody is asked for the password"
    assert "without a password" in capsys.readouterr().err
    assert not (tmp_path / "d").exists()


@pytest.mark.long
def test_an_error_of_the_work_is_not_blamed_on_the_scheduler(certificate, scheduler, monkeypatch, tmp_path, capsys):
    from gof_benchmark.generator import graph

    def full(self):
        raise OSError(28, "No space left on device", "somewhere.exr")

    monkeypatch.setattr(graph.Generation, "run", full)
    words = ["generate", "demo", "--preset", "toy", "--out", str(tmp_path / "d"), "--tls", str(certificate)]
    assert main([*words, "--scheduler", scheduler.scheduler_address]) == 1
    said = capsys.readouterr().err
    assert "somewhere.exr: No space left" in said and "scheduler" not in said
