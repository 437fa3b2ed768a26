"""Nothing listens unless it is asked to, and then on loopback, to pages of its own."""

import re
import shutil
import socket
import subprocess
import threading
import urllib.error
import urllib.request

import psutil
import pytest

from gof.commands.cli import main
from gof.look.player.live import Live, serve
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
def view(tmp_path_factory):
    """The port of a view that answers, and the sockets that listen because of it."""
    path = random_gaussians(20).save(tmp_path_factory.mktemp("view") / "result.npz")
    before = listening()
    with serve(Live(path)) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield server.server_address[1], listening() - before
        server.shutdown()


def get(port: int, place: str = "/", **headers: str) -> int:
    request = urllib.request.Request(f"http://127.0.0.1:{port}{place}", headers=headers)
    try:
        return urllib.request.urlopen(request, timeout=20).status
    except urllib.error.HTTPError as e:
        return e.code


def test_the_view_listens_on_loopback_only(view):
    port, sockets = view
    assert sockets == {("127.0.0.1", port)}


@pytest.mark.parametrize("place", ["/", "/news?have=", "/instant?time=0"])
def test_a_foreign_page_gets_nothing(view, place):
    """Any page in the same browser may ask 127.0.0.1, under its own name (Origin) or one that it has bent (Host)."""
    port, _ = view
    own = f"http://localhost:{port}"
    assert get(port, place) == 200, "a program that sends no origin"
    assert get(port, place, Origin=f"http://127.0.0.1:{port}") == 200
    assert get(port, place, Host=f"localhost:{port}", Origin=own) == 200
    assert get(port, place, Host="localhost:9999", Origin="http://localhost:9999") == 200, "through a tunnel of ssh"
    for origin in ("http://evil.example", "null", f"http://localhost:{port + 1}", f"{own}.evil.example"):
        assert get(port, place, Origin=origin) == 403, origin
    for host in ("rebind.evil.example", f"rebind.evil.example:{port}", f"127.0.0.1.evil.example:{port}", "", "[::1"):
        assert get(port, place, Host=host) == 403, host


def test_no_other_page_may_read_or_embed_the_answer(view):
    with urllib.request.urlopen(f"http://127.0.0.1:{view[0]}/news?have=", timeout=20) as answer:
        said = {name.lower(): value for name, value in answer.headers.items()}
    assert "access-control-allow-origin" not in said and said["cross-origin-resource-policy"] == "same-origin"


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
        def __init__(self, spec, layout, workers, log, machine):
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
