"""The places where the tasks of a dataset run: threads of this process, or the workers of a running dask scheduler.

Both have the interface of `concurrent.futures.Executor`. A task waits for a Blender process, so threads are enough.
"""

from __future__ import annotations

import itertools
import queue
import ssl
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from gof.core.errors import GofError
from gof.host import extras
from gof_benchmark.generator.blender_process import end

RETRIES = 3
CERTIFICATE = ("cert.pem", "key.pem")


class LocalWorkers(Executor):
    """Threads that take the waiting task of highest priority, the older of two; a task that raises is tried again.

    They are daemons: a Blender at work does not keep a run that has failed from ending. Use as a context.
    """

    def __init__(self, workers: int):
        self._waiting: queue.PriorityQueue = queue.PriorityQueue()
        self._number = itertools.count()
        self._closed = False
        for _ in range(workers):
            threading.Thread(target=self._work, daemon=True).start()

    def submit(self, function: Callable, /, *args: Any, priority: int = 0, **options: Any) -> Future:
        """Start `function(*args, **options)` when its turn comes."""
        future: Future = Future()
        self._waiting.put((-priority, next(self._number), future, partial(function, *args, **options)))
        return future

    def leave(self, root: Path) -> None:
        """End what works at a dataset, for good."""
        self.shutdown()
        end(root)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Take no other task, and try none again; what runs is not waited for."""
        self._closed = True
        self._waiting.put((float("-inf"), next(self._number), None, None))

    def _work(self) -> None:
        while True:
            first = self._waiting.get()
            _, _, future, task = first
            if future is None:
                self._waiting.put(first)  # for the next thread
                return
            if future.set_running_or_notify_cancel():
                self._try(future, task)

    def _try(self, future: Future, task: Callable) -> None:
        for left in reversed(range(RETRIES + 1)):
            try:
                result = task()
            except BaseException as error:
                if not left or self._closed:
                    future.set_exception(error)
                    return
            else:
                future.set_result(result)
                return


class ClusterWorkers:
    """The workers of a dask client, with the interface of `LocalWorkers`."""

    def __init__(self, client: Any):
        self.client = client
        self.submit = client.get_executor(pure=False, retries=RETRIES).submit

    def leave(self, root: Path) -> None:
        """End what works at a dataset, on every worker; the futures are cancelled."""
        self.client.run(end, root)


@contextmanager
def workers_for(
    scheduler: str | None, workers: int, tls: Path | None = None
) -> Iterator[LocalWorkers | ClusterWorkers]:
    """Workers of a running scheduler, or so many in this process.

    Args:
        tls: folder with the cert.pem and key.pem that the scheduler requires (docs/cluster.md).
    Raises:
        GofError: the scheduler does not answer, or see `require_certificate`.
        MissingDependencyError: there is a scheduler, and distributed is not installed.
    """
    require_certificate(scheduler, tls)
    if scheduler is None:
        with LocalWorkers(workers) as local:
            yield local
    else:
        with _connect(scheduler, tls) as client:
            yield ClusterWorkers(client)


def require_certificate(scheduler: str | None, tls: Path | None) -> None:
    """Make sure that an address and a certificate go together, before anything is connected or written.

    Raises:
        GofError: an address without encryption is given a certificate, one with encryption is given none, or the
            folder holds no certificate with its key.
    """
    if scheduler is None:
        if tls is not None:
            raise GofError("--tls is for the scheduler of --scheduler; give its address too, or leave --tls out")
        return
    encrypted = scheduler.startswith("tls://")
    if tls is None:
        if encrypted:
            raise GofError(f"no dask scheduler answers at {scheduler} without a certificate; give --tls FOLDER")
        print(f"{scheduler}: without --tls, anyone who reaches that port can run programs as you", file=sys.stderr)
        return
    if not encrypted:
        raise GofError(
            f"--tls needs a scheduler at tls://HOST:PORT, and --scheduler {scheduler} is not encrypted; start the "
            "scheduler with '--protocol tls' and its certificate (docs/cluster.md)"
        )
    missing = [name for name in CERTIFICATE if not (tls / name).is_file()]
    if missing:
        raise GofError(f"{tls}: has no {' and no '.join(missing)}; docs/cluster.md says how to make them")
    cert, key = (str(tls / name) for name in CERTIFICATE)
    try:
        ssl.create_default_context(cafile=cert).load_cert_chain(cert, key, password="")
    except (ssl.SSLError, OSError) as e:
        raise GofError(
            f"{tls}: cert.pem and key.pem are no certificate with its key, without a password ({e}); docs/cluster.md "
            "says how to make them"
        ) from e


def _connect(scheduler: str, tls: Path | None) -> Any:
    """Return a client of a running scheduler. Raises GofError: it does not answer, or not to this certificate."""
    distributed = extras.load("distributed", "cluster", "--scheduler")
    security = None
    if tls is not None:
        cert, key = (str(tls / name) for name in CERTIFICATE)
        security = distributed.Security(
            require_encryption=True, tls_ca_file=cert, tls_client_cert=cert, tls_client_key=key
        )
    try:
        return distributed.Client(scheduler, timeout=20, security=security)
    except (OSError, TimeoutError, ValueError) as error:
        raise GofError(
            f"no dask scheduler answers at {scheduler} ({error}); start one with 'dask scheduler'"
        ) from error
