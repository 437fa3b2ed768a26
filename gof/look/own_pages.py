"""Whom a server for a browser answers: pages that it has served itself, under a name that is this machine's.

A browser lets every page on the web ask addresses of the machine it runs on. It says so in `Origin`; and a page whose
own name was bent to this machine (DNS rebinding) still sends that name as `Host`.
"""

from __future__ import annotations

import ipaddress
import logging
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from http import HTTPStatus
from typing import Any
from urllib.parse import urlsplit

from gof.core.errors import printable


def is_own_page(headers: Mapping[str, str], host: str) -> bool:
    """Whether a request is one of a page of ours, or of a program that is no browser.

    Args:
        headers: of the request.   host: the address that the server was asked to listen on.
    """
    try:
        asked = urlsplit(f"//{headers.get('Host', '')}")
        origin = headers.get("Origin")
        known = _is_ours(asked.hostname, host)
        return known and (origin is None or origin in (f"http://{asked.netloc}", f"https://{asked.netloc}"))
    except ValueError:  # no address at all
        return False


def _is_ours(name: str | None, host: str) -> bool:
    """A number is no name that anybody could bend."""
    if not name:
        return False
    if name in ("localhost", host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()):
        return True
    try:
        ipaddress.ip_address(name)
        return True
    except ValueError:
        return False


def _quiet_logger() -> logging.Logger:
    """A log with a line, and no traceback, on a connection that ends because it sends no messages of a viewer."""

    def in_a_line(record: logging.LogRecord) -> bool:
        if record.exc_info and record.exc_info[1] is not None:
            error, record.exc_info = record.exc_info[1], None
            said = printable(" ".join(str(error).split()))[:100]
            record.msg, record.args = (
                f"a connection was closed: {record.getMessage()} ({type(error).__name__}: {said})",
                (),
            )
        return True

    logger = logging.getLogger("gof.view")
    logger.filters = [in_a_line]
    return logger


@contextmanager
def only_own_pages(host: str) -> Iterator[None]:
    """Websocket servers that are started in this block answer 403 to everybody but `is_own_page`.

    Raises:
        RuntimeError: none was started, so nothing guards it.
    """
    import websockets.asyncio.server as library

    serve, guarded = library.serve, []

    def guarded_serve(*args: Any, process_request: Any = None, **options: Any) -> Any:
        def process(connection: Any, request: Any) -> Any:
            if not is_own_page(request.headers, host):
                return connection.respond(HTTPStatus.FORBIDDEN, "not a page of this server\n")
            return process_request and process_request(connection, request)

        guarded.append(process)
        return serve(*args, process_request=process, **{"logger": _quiet_logger()} | options)

    library.serve = guarded_serve
    try:
        yield
    finally:
        library.serve = serve
    if not guarded:
        raise RuntimeError("the server came up unguarded: this version of viser starts in another way")
